"""Agents that tokens of the vision network say are there."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.generate.seen_agents import held_scene, seen_agents
from scjax.scene import AgentType, Crop, validate
from scjax.scene.boxes import overlaps
from tests.factories.object_tokens import CAR, PEDESTRIAN, VEHICLE, tokens


def test_cells_that_agree_are_one_agent():
    near = [(VEHICLE, 12.0 + 0.3 * k, 3.0, 0.5, 4.5, 1.8) for k in (-1, 0, 1)]
    seen = seen_agents(tokens(*near, *[(PEDESTRIAN, 20.0, -5.0, -1.0, 0.6, 0.6)] * 2))
    assert seen.types.tolist() == [AgentType.VEHICLE, AgentType.PEDESTRIAN]
    np.testing.assert_allclose(seen.places, [[12.0, 3.0], [20.0, -5.0]], atol=1e-4)
    np.testing.assert_allclose(seen.headings, [0.5, -1.0], atol=1e-4)
    np.testing.assert_allclose(seen.sizes, [[4.5, 1.8], [0.6, 0.6]], atol=1e-4)


@pytest.mark.parametrize("place", [(80.0, 0.0), (1.0, 0.0), (20.0, 40.0)])
def test_what_is_far_or_beside_the_window_is_left_out(place):
    assert not len(seen_agents(tokens(*[(VEHICLE, *place, 0.0, 4.5, 1.8)] * 3)).types)


def test_one_cell_alone_is_no_agent():
    assert not len(seen_agents(tokens(CAR)).types)


def test_order_of_cells_does_not_matter():
    objects = tokens(*[CAR] * 3, *[(VEHICLE, 25.0, -8.0, 3.0, 8.0, 2.4)] * 2)
    first, second = seen_agents(objects), seen_agents(objects[::-1])
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_boxes_that_overlap_a_little_are_moved_apart():
    cars = seen_agents(tokens(*[CAR] * 3, *[(VEHICLE, 15.7, 5.0, 0.5, 4.5, 1.8)] * 2))
    assert not overlaps(held_scene(cars, np.zeros(3), 0).agents.astype(np.float64)).any()
    np.testing.assert_allclose(cars.places[0], [12.0, 3.0], atol=1e-4)  # the surer one stays
    assert 0.1 < np.hypot(*(cars.places[1] - [15.7, 5.0])) < 0.8


def test_of_two_boxes_in_one_place_the_surer_one_stays():
    cars = seen_agents(tokens(*[(VEHICLE, 20.0, 3.0, 0.0, 12.0, 2.5)] * 3, *[(VEHICLE, 23.5, 3.0, 0.0, 4.5, 1.8)] * 2))
    np.testing.assert_allclose(cars.sizes, [[12.0, 2.5]], atol=1e-4)


def test_held_scene_is_valid_and_says_what_is_unknown():
    scene = held_scene(seen_agents(tokens(*[CAR] * 3)), np.array([8.0, 2.0]), domain=1)
    validate(scene)
    assert scene.crop == Crop.FORWARD and scene.domain == 1 and not scene.lane_mask.size
    np.testing.assert_allclose(scene.agents[:, 3], [8.0, 2.0])
    assert not scene.agent_known[:, [2, 3, 8]].any() and scene.agent_known[:, [0, 1, 4, 5, 6, 7]].all()
