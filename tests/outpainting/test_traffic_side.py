"""The side of the road on which traffic keeps, and faults of tiles, on lanes written by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.outpainting.coverage import Coverage
from scjax.outpainting.dead_turns import DeadTurns
from scjax.outpainting.tile_candidate import tile_candidate
from scjax.outpainting.traffic_side import keeps_right, on_other_side, oncoming_lengths
from scjax.outpainting.window import KnownWindow, WindowPose, cut_window
from scjax.scene import Link, Map, MapLane
from tests.factories.maps import two_tile_map


def _lane(start: tuple[float, float], end: tuple[float, float], height: float = 0.0) -> np.ndarray:
    return np.array([[*start, height], [*end, height]])


_EAST, _WEST = _lane((0, -2), (40, -2)), _lane((40, 2), (0, 2))
_MIRROR = np.array([1.0, -1.0, 1.0])
_POINTS = 20  # of a lane of a sample


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


def _faults(*new: np.ndarray) -> tuple[str, ...]:
    """The faults of a tile that adds lanes to a road of the map in both directions."""
    map = two_tile_map()
    points = map.lanes[0].points[::-1] + np.array([0.0, 4.0, 0.0])
    oncoming = dataclasses.replace(map.lanes[0], id="oncoming", points=points)
    map = dataclasses.replace(map, lanes=(*map.lanes, oncoming))
    pose = WindowPose(95.5, -2.0, 0.0, 0.0)
    known = cut_window(map, pose)
    window = KnownWindow(pose, map, known, (), DeadTurns(map, (), 0.0, 0.0))
    count, more = len(known.lane_mask), len(new)
    links = np.full((count + more, count + more), Link.NONE)
    links[:count, :count] = known.links
    sample = known.replace(
        lanes=np.concatenate([known.lanes, new]),
        lane_mask=np.ones(count + more, bool),
        links=links,
        signals=np.zeros(count + more, int),
    )
    return tile_candidate(sample, window, Coverage(map), "2").faults


def _straight(start: tuple[float, float], end: tuple[float, float]) -> np.ndarray:
    return np.linspace([*start, 0.0], [*end, 0.0], _POINTS)


@pytest.mark.parametrize(("center", "is_fault"), [(24.0, False), (16.0, True)])
def test_a_tile_whose_lanes_change_sides_has_a_fault(center, is_fault):
    """Two new lanes, the oncoming one on the left, or on the right."""
    faults = _faults(_straight((3.0, 20.0), (30.0, 20.0)), _straight((30.0, center), (3.0, center)))
    assert ("2 lanes are on the oncoming side" in faults) == is_fault


@pytest.mark.parametrize(("start", "is_fault"), [((12.0, 20.3), True), ((12.0, 23.0), False), ((3.0, 20.3), False)])
def test_a_tile_with_lanes_on_each_other_has_a_fault(start, is_fault):
    """A second lane of one direction on the first one, beside it, or from the same place."""
    faults = _faults(_straight((3.0, 20.0), (24.0, 20.0)), _straight(start, (31.0, start[1])))
    assert ("lanes lie on each other" in faults) == is_fault


def test_the_roads_of_a_window_say_more_than_those_elsewhere():
    here = [_EAST * _MIRROR, _WEST * _MIRROR]
    far = [line * np.array([2.0, 1.0, 1.0]) + np.array([400.0, 0.0, 0.0]) for line in (_EAST, _WEST)]  # longer
    lanes = [MapLane(id=str(row), lane_type=None, points=line) for row, line in enumerate([*here, *far])]
    map = Map(lanes=tuple(lanes))
    known = cut_window(map, WindowPose(20.0, 0.0, 0.0, 0.0))
    for x, right in ((20.0, False), (440.0, True), (220.0, True)):
        window = KnownWindow(WindowPose(x, 0.0, 0.0, 0.0), map, known, (), DeadTurns(map, (), x, 0.0))
        assert window.keeps_right is right
