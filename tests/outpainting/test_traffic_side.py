"""The side of the road on which traffic keeps, on lanes written by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.outpainting.coverage import Coverage
from scjax.outpainting.dead_turns import DeadTurns
from scjax.outpainting.tile_candidate import tile_candidate
from scjax.outpainting.traffic_side import keeps_right, on_other_side, oncoming_lengths
from scjax.outpainting.window import KnownWindow, WindowPose, cut_window
from scjax.scene import AgentType, Link, Map, MapLane, Scene
from tests.factories.maps import two_tile_map


def _lane(start: tuple[float, float], end: tuple[float, float], height: float = 0.0) -> np.ndarray:
    return np.array([[*start, height], [*end, height]])


_EAST, _WEST = _lane((0, -2), (40, -2)), _lane((40, 2), (0, 2))
_MIRROR = np.array([1.0, -1.0, 1.0])


def test_oncoming_lanes_are_counted_by_the_meter_on_their_side():
    lengths = oncoming_lengths([_EAST, _WEST, _lane((100, 0), (140, 0))])
    assert lengths.tolist() == [[41, 0], [41, 0], [0, 0]]


def test_mirrored_roads_keep_to_the_other_side():
    assert keeps_right([_EAST, _WEST]) is True
    assert keeps_right([_EAST * _MIRROR, _WEST * _MIRROR]) is False


@pytest.mark.parametrize(
    "other",
    [
        _lane((0, 2), (40, 2)),  # of the same direction
        _lane((40, 9), (0, 9)),  # too far
        _lane((40, 2), (0, 2), height=6.0),  # on a bridge
        _lane((20, 40), (20, -40)),  # across
    ],
)
def test_lanes_that_are_not_oncoming_say_nothing(other):
    assert keeps_right([_EAST, other]) is None
    assert not on_other_side([_EAST, other], True).any() and not on_other_side([_EAST, other], False).any()


def test_lanes_on_the_other_side_are_found_by_the_given_side_or_by_most_lanes():
    swapped = [_lane((0, 50), (15, 50)), _lane((15, 46), (0, 46))]
    lines = [_EAST, _WEST, *swapped]
    assert on_other_side(lines, True).tolist() == [False, False, True, True]
    assert on_other_side(lines, None).tolist() == [False, False, True, True]
    assert on_other_side(lines, False).tolist() == [True, True, False, False]


def test_no_lines_have_no_side():
    assert keeps_right([]) is None and on_other_side([], None).shape == (0,)


@pytest.mark.parametrize(("center", "fault"), [(-4.0, ""), (4.0, "2 lanes are on the oncoming side")])
def test_a_tile_whose_lanes_change_sides_has_a_fault(center, fault):
    """Two new lanes beside the map's, the oncoming one on the left, or on the right."""
    map = two_tile_map()
    points = map.lanes[0].points[::-1] + np.array([0.0, 4.0, 0.0])
    oncoming = dataclasses.replace(map.lanes[0], id="oncoming", points=points)
    map = dataclasses.replace(map, lanes=(*map.lanes, oncoming))
    pose = WindowPose(95.5, -2.0, 0.0, 0.0)
    known = cut_window(map, pose)
    window = KnownWindow(pose, map, known, (), DeadTurns(map, (), 0.0, 0.0))
    assert window.keeps_right is True
    there = np.linspace([3.0, 20.0, 0.0], [30.0, 20.0, 0.0], known.lanes.shape[1])
    back = there[::-1] - [0.0, center, 0.0]
    count = len(known.lane_mask)
    links = np.full((count + 2, count + 2), Link.NONE)
    links[:count, :count] = known.links
    sample = known.replace(
        lanes=np.concatenate([known.lanes, [there, back]]),
        lane_mask=np.ones(count + 2, bool),
        links=links,
        signals=np.zeros(count + 2, int),
    )
    assert isinstance(sample, Scene) and AgentType.VEHICLE in sample.agent_types
    faults = tile_candidate(sample, window, Coverage(map), "2").faults
    assert (fault in faults) if fault else not any("oncoming" in one for one in faults)


def test_the_roads_of_a_window_say_more_than_those_elsewhere():
    here = [_EAST * _MIRROR, _WEST * _MIRROR]
    far = [line * np.array([2.0, 1.0, 1.0]) + np.array([400.0, 0.0, 0.0]) for line in (_EAST, _WEST)]  # longer
    lanes = [MapLane(id=str(row), lane_type=None, points=line) for row, line in enumerate([*here, *far])]
    map = Map(lanes=tuple(lanes))
    known = cut_window(map, WindowPose(20.0, 0.0, 0.0, 0.0))
    for x, right in ((20.0, False), (440.0, True), (220.0, True)):
        window = KnownWindow(WindowPose(x, 0.0, 0.0, 0.0), map, known, (), DeadTurns(map, (), x, 0.0))
        assert window.keeps_right is right
