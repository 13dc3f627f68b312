"""Roundabouts and intersections of lanes drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.language.facts import extract_facts
from scjax.language.intersections import find_intersections
from scjax.language.road import road_from_scene
from scjax.scene import Scene, empty
from tests.factories.hand_drawn_scene import SceneBuilder


def has_roundabout(scene: Scene) -> bool:
    return extract_facts(scene).layout == "roundabout"


def ring_road(quarters: list[np.ndarray]) -> Scene:
    """A closed line in four lanes, each linked to the next, and two roads that lead there."""
    builder = SceneBuilder(speed=6.0)
    builder.add_lane((0, 32), (0, 15))
    builder.add_lane((0, -32), (0, -15))
    lanes = [builder.add_lane(*quarter) for quarter in quarters]
    builder.link(*[(lanes[k], lanes[(k + 1) % 4]) for k in range(4)])
    return builder.scene()


@pytest.mark.parametrize("corners", [7, 20])
@pytest.mark.parametrize("flip", [1, -1])
def test_has_roundabout_with_few_points_either_direction(corners, flip):
    angles = [np.deg2rad(np.linspace(90 * k, 90 * k + 90, corners)) for k in range(4)]
    assert has_roundabout(ring_road([14 * np.stack([np.cos(turn), flip * np.sin(turn)], -1) for turn in angles]))


def test_has_roundabout_rejects_block_with_round_corners():
    angle = np.deg2rad(np.linspace(0, 90, 8))
    corner = np.concatenate([[[9, -5]], 5 * np.stack([np.cos(angle), np.sin(angle)], -1) + [4, 4]])
    quarters = []
    for k in range(4):
        turn = np.deg2rad(90 * k)
        quarters.append(corner @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]))
    assert all(np.allclose(quarters[k][-1], quarters[(k + 1) % 4][0], atol=1.01) for k in range(4))
    assert not has_roundabout(ring_road(quarters))


def circulation(*, rings=(14.0,), start=0.0, end=360.0, gap=0.0, arms=4, sense=1) -> Scene:
    """Quarters of rings, open by ``gap`` meters at their ends, with roads that lead there; links are absent."""
    builder = SceneBuilder(speed=6.0)
    for radius in rings:
        for low in np.arange(start, end, 90.0):
            cut = np.rad2deg(gap / radius)
            turn = np.deg2rad(np.linspace(low, min(low + 90.0, end) - cut, 12))
            builder.add_lane(*(radius * np.stack([np.cos(turn), sense * np.sin(turn)], -1)))
    for turn in np.deg2rad(np.linspace(start, end, arms, endpoint=False) + 20.0):
        direction = np.array([np.cos(turn), sense * np.sin(turn)])
        builder.add_lane(32 * direction, (max(rings) + 1) * direction)
    return builder.scene()


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize(
    "shape", [{"gap": 1.5}, {"rings": (12.0, 15.5)}, {"rings": (20.0,), "start": -130.0, "end": 130.0}, {"arms": 2}]
)
def test_has_roundabout_by_circulation(shape, sense):
    """An open joint, two lanes side by side, a ring that the window cuts, two roads only; no lane is linked."""
    assert has_roundabout(circulation(**shape, sense=sense))


@pytest.mark.parametrize("shape", [{"end": 180.0}, {"arms": 0}, {"arms": 1}])
def test_has_roundabout_rejects_bends_and_turning_circles(shape):
    assert not has_roundabout(circulation(gap=1.0, **shape))


def test_find_intersections_is_empty_for_a_tangle_of_lanes():
    """Untrained models draw such scenes; comparing all their crossings took minutes and gigabytes."""
    scene = empty(1, 60).replace(
        lanes=np.random.default_rng(0).normal(0, 12, (60, 20, 3)).astype(np.float32),
        lane_mask=np.ones(60, bool),
        agent_mask=np.ones(1, bool),
    )
    assert find_intersections(road_from_scene(scene))[0] == []
    assert extract_facts(scene).layout not in ("four-way", "T", "complex")
