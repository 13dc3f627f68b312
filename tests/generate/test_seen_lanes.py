"""Lanes that a picture shows, and scenes that are shifted onto them."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.encoders.dashcam_network import FINE, PLACE_SCALE, DashcamConfig
from scjax.generate.seen_lanes import SeenLanes, seen_lanes, shift_to_seen
from scjax.scene import Crop, empty

CELL = (DashcamConfig().width - DashcamConfig().features) // FINE**2  # numbers of a fine cell


def scene():
    """A road ahead, one across at 30 m, and a car on each."""
    one = empty(3, 2, crop=Crop.FORWARD)
    lanes = np.zeros(one.lanes.shape, np.float32)
    lanes[0, :, 0] = np.linspace(0, 64, lanes.shape[1])
    lanes[1, :, 0], lanes[1, :, 1] = 30.0, np.linspace(-32, 32, lanes.shape[1])
    agents = np.zeros((3, 9), np.float32)
    agents[:, 4], agents[:, 6:] = 1.0, (4.6, 1.9, 1.6)
    agents[1, 0], agents[2, :2], agents[2, 4:6] = 20.0, (30.0, 8.0), (0.0, 1.0)
    return one.replace(agents=agents, lanes=lanes, agent_mask=np.ones(3, bool), lane_mask=np.ones(2, bool))


def seen(ahead=0.0, left=0.0):
    """What a picture of that scene shows if it lies elsewhere."""
    x, y = np.arange(4.0, 40.0), np.arange(-10.0, 11.0)
    points = np.concatenate([np.stack([x, np.full_like(x, left)], 1), np.stack([np.full_like(y, 30 + ahead), y], 1)])
    return SeenLanes(points, np.repeat([[1.0, 0.0], [0.0, 1.0]], [len(x), len(y)], 0))


@pytest.mark.parametrize(("ahead", "left"), [(0.0, 0.8), (3.0, 0.0), (-3.0, 0.5)])
def test_lanes_go_where_they_are_seen(ahead, left):
    after = shift_to_seen(scene(), 1, seen(ahead, left))
    near = (after.lanes[0, :, 0] > 4) & (after.lanes[0, :, 0] < 40)
    assert np.abs(after.lanes[0, near, 1] - left).max() < 0.3
    middle = np.abs(after.lanes[1, :, 1]) < 10
    assert np.abs(after.lanes[1, middle, 0] - 30 - ahead).max() < 0.4


def test_lanes_that_are_seen_where_they_are_stay():
    before = scene()
    np.testing.assert_array_equal(shift_to_seen(before, 1, seen()).lanes, before.lanes)


def test_agents_go_with_their_lanes_but_for_those_that_are_seen():
    before = scene()
    after = shift_to_seen(before, 2, seen(3.0, 0.0))
    np.testing.assert_array_equal(after.agents[:2], before.agents[:2])
    assert 2.5 < after.agents[2, 0] - 30.0 < 3.5
    np.testing.assert_allclose(np.hypot(*after.agents[2, 4:6]), 1.0, atol=1e-6)


def test_lanes_end_at_the_border_as_before():
    after = shift_to_seen(scene(), 1, seen(3.0, 0.8))
    np.testing.assert_allclose(after.lanes[0, [0, -1], 0], [0.0, 64.0], atol=1e-6)
    np.testing.assert_allclose(after.lanes[1, [0, -1], 1], [-32.0, 32.0], atol=1e-6)


def test_few_points_shift_nothing():
    before, points = scene(), seen(3.0)
    assert shift_to_seen(before, 1, SeenLanes(points.points[:5], points.headings[:5])) is before


def test_seen_lanes_have_one_point_in_each_place():
    fine = np.zeros((4 * FINE**2, CELL), np.float32)
    fine[:, 26] = -8.0  # no lane
    fine[:3, 21:27] = (12.0 / PLACE_SCALE, 3.0 / PLACE_SCALE, 2.0, 0.0, 0.0, 6.0)
    lanes = seen_lanes(np.concatenate([np.ones((4, 5)), fine.reshape(4, -1)], 1))
    np.testing.assert_allclose(lanes.points, [[12.0, 3.0]], atol=1e-5)
    np.testing.assert_allclose(lanes.headings, [[1.0, 0.0]], atol=1e-6)
