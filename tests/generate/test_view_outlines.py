"""Outlines of forward windows, chosen by pictures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.generate.seen_lanes import SeenLanes
from scjax.generate.view_outlines import ViewOutlines, kind_numbers, picture_features
from scjax.generate.view_roads import BYTES, SQUARES
from scjax.models.denoiser.kinds import SECTORS

SIZES = (3, 2), (2, 3)
GRID = (4, 3)
SCENES = 400


def kinds(rng, tokens, sizes):
    """Random kinds of a random number of tokens each."""
    values = rng.integers(0, sizes[0] * sizes[1], (SCENES, tokens))
    return np.where(np.arange(tokens) < rng.integers(1, tokens + 1, (SCENES, 1)), values, -1)


@pytest.fixture(scope="module")
def data():
    """Pictures whose cells are linear in the numbers of kinds."""
    rng = np.random.default_rng(0)
    lanes, agents = kinds(rng, 6, SIZES[0]), kinds(rng, 5, SIZES[1])
    numbers = np.concatenate([kind_numbers(lanes, SIZES[0]), kind_numbers(agents, SIZES[1])], 1)
    pictures = numbers @ rng.normal(size=(numbers.shape[1], 4 * 3 * 2)).astype(np.float32)
    return lanes, agents, pictures.reshape(SCENES, 12, 2)


@pytest.fixture(scope="module")
def views(data):
    lanes, agents, pictures = data
    features = np.stack([picture_features(one, GRID) for one in pictures])
    return ViewOutlines.fit(lanes, agents, np.arange(SCENES) % 2, features, SIZES, SCENES)


def test_kind_numbers_count_tokens_and_digits():
    numbers = kind_numbers(np.array([[0, 4, -1], [5, 5, 5]]), (3, 2))
    assert numbers.tolist() == [[2, 1, 1, 0, 1, 1], [3, 0, 0, 3, 0, 3]]


def test_draw_finds_an_outline_with_the_numbers_of_the_picture(data, views):
    lanes, agents, pictures = data
    known = np.concatenate([kind_numbers(lanes, SIZES[0]), kind_numbers(agents, SIZES[1])], 1)
    rng = np.random.default_rng(1)
    for row in range(0, SCENES, 80):
        drawn = views.draw(rng, pictures[row], GRID)
        nearest = np.sort(np.abs(known - known[row]).sum(1))[:30]
        assert np.abs(known[drawn] - known[row]).sum() <= nearest[-1]


def test_draw_follows_given_numbers_where_the_picture_says_little(data, views):
    lanes, _, pictures = data
    unsure = dataclasses.replace(views, deviations=10 * np.ones_like(views.deviations))
    drawn = unsure.draw(np.random.default_rng(0), pictures[0], GRID, num_lanes=6)
    assert (lanes[drawn] >= 0).sum() == 6


def test_draw_follows_the_picture_before_given_numbers(data, views):
    _, _, pictures = data
    certain = dataclasses.replace(views, deviations=1e-3 * np.ones_like(views.deviations))
    draws = [certain.draw(np.random.default_rng(0), pictures[0], GRID, num_lanes=number) for number in (None, 6)]
    assert draws[0] == draws[1]


def test_files_hold_the_outlines(views):
    again = ViewOutlines.from_files(views.arrays(), SIZES)
    for name, array in views.arrays().items():
        np.testing.assert_array_equal(array, again.arrays()[name])


@pytest.mark.parametrize("name", ["lanes", "domains", "weights", "deviations"])
def test_damaged_arrays_are_named(views, name):
    arrays = views.arrays() | {name: views.arrays()[name][:-1]}
    with pytest.raises(ValueError, match=f"view outlines: .*{name}" if name != "domains" else "view outlines: lanes"):
        ViewOutlines.from_files(arrays, SIZES) if name != "weights" else dataclasses.replace(
            views, weights=views.weights[:, :-1]
        ).check()


def test_picture_of_other_features_is_refused(data, views):
    with pytest.raises(ValueError, match="a picture has"):
        views.draw(np.random.default_rng(0), np.zeros((12, 3)), GRID)


def test_draw_prefers_windows_whose_lanes_lie_like_those_that_are_seen(data, views):
    _, _, pictures = data
    points = np.stack([np.arange(4.5, 36.0), np.full(32, 1.0)], 1)
    seen = SeenLanes(points, np.broadcast_to([1.0, 0.0], points.shape))
    bins = np.zeros((len(SQUARES), SECTORS), bool)
    bins[np.abs(SQUARES[:, 1] - 1.0) < 0.5, 0] = True
    roads = np.zeros((SCENES, BYTES), np.uint8)
    alike = np.array([11, 50, 200, 333])
    roads[alike] = np.packbits(bins.ravel())
    unsure = dataclasses.replace(views, deviations=100 * np.ones_like(views.deviations), roads=roads)
    draws = {unsure.draw(np.random.default_rng(k), pictures[0], GRID, seen=seen) for k in range(20)}
    assert draws <= set(alike.tolist()) and len(draws) > 1
    few = SeenLanes(points[:4], seen.headings[:4])
    without = [
        unsure.draw(np.random.default_rng(k), pictures[0], GRID, seen=one) for k in range(5) for one in (few, None)
    ]
    assert without[::2] == without[1::2]


def test_files_hold_roads_and_damaged_ones_are_named(views):
    roads = np.zeros((SCENES, BYTES), np.uint8)
    arrays = dataclasses.replace(views, roads=roads).arrays()
    np.testing.assert_array_equal(ViewOutlines.from_files(arrays, SIZES).roads, roads)
    assert ViewOutlines.from_files(views.arrays(), SIZES).roads is None
    with pytest.raises(ValueError, match="view outlines: roads has shape"):
        ViewOutlines.from_files(arrays | {"roads": roads[:, 1:]}, SIZES)
