"""Forks and merges that the border of a scene cut, in OpenDRIVE files."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.export.base import Losses
from scjax.export.roads.cut_forks import SHARED_LENGTH, join_cut_forks
from scjax.export.roads.lane_network import LaneNetwork
from scjax.scene import MapLane


def straight(start, end, count: int = 11) -> np.ndarray:
    return np.linspace(np.array([*start, 0.0]), np.array([*end, 0.0]), count)


def network(*lines, kinds=None) -> LaneNetwork:
    lanes = tuple(MapLane(str(row), kinds[row] if kinds else "surface_street", line) for row, line in enumerate(lines))
    blank = ((),) * len(lanes)
    return LaneNetwork(lanes, tuple(lines), blank, blank, blank, blank)


@pytest.mark.parametrize("at_end", [False, True])
def test_lanes_that_begin_or_end_at_one_place_share_a_road(at_end):
    lines = [straight((0, 0), (20, 0)), straight((0, 0.4), (20, 2)), straight((0, 3.5), (20, 3.5))]
    before = network(*(line[::-1].copy() if at_end else line for line in lines))
    losses = Losses()
    after = join_cut_forks(before, losses)
    assert len(after.lanes) == 4 and after.lanes[3].id == "0+1"
    links = after.successors if at_end else after.predecessors
    assert links == ((3,), (3,), (), ())
    assert (after.predecessors if at_end else after.successors)[3] == (0, 1)
    near, far = (-1, 0) if at_end else (0, -1)
    for row in (0, 1):
        rest = after.lines[row]
        assert np.linalg.norm(rest[near] - before.lines[row][near]) == pytest.approx(SHARED_LENGTH)
        np.testing.assert_array_equal(rest[far], before.lines[row][far])
        assert np.linalg.norm(rest[near] - after.lines[3][far]) < 1.0
    np.testing.assert_array_equal(after.lines[2], before.lines[2])
    assert losses["lanes that begin or end at one place, which share a road there"] == 2


def test_lanes_of_two_types_or_directions_share_nothing():
    street, cycle = straight((0, 0), (20, 0)), straight((0, 0.3), (20, 0.3))
    kinds = ["surface_street", "bike_lane"]
    assert len(join_cut_forks(network(street, cycle, kinds=kinds), Losses()).lanes) == 2
    across = straight((0, 0), (14, 14))
    assert len(join_cut_forks(network(street, across), Losses()).lanes) == 2


def test_short_lanes_share_nothing():
    lines = straight((0, 0), (7, 0)), straight((0, 0.3), (7, 0.3))
    assert len(join_cut_forks(network(*lines), Losses()).lanes) == 2
