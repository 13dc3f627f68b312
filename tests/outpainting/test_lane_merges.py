"""Lanes that go on where they would end dead: into the lane beside, or to the border."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.outpainting.bends import Joint
from scjax.outpainting.coverage import OpenEnd, outward_heading
from scjax.outpainting.lane_merges import NO_ROW, DeadEnd, NewLanes, merge_beside, reach_border
from scjax.outpainting.measures import kinks_of
from scjax.scene.angles import wrap_to_pi


def _line(x: float, y: float, end_x: float, end_y: float | None = None) -> np.ndarray:
    return np.linspace((x, y, 0.0), (end_x, y if end_y is None else end_y, 0.0), 20)


def _end(x: float, y: float, outward: float = 0.0, is_start: bool = False, name: str = "known") -> OpenEnd:
    return OpenEnd(name, is_start, np.array([x, y, 0.0]), outward, True)


def _new(*lines: np.ndarray, edges=(), joints=()) -> NewLanes:
    return NewLanes(list(lines), list(range(len(lines))), list(edges), list(joints))


@pytest.mark.parametrize("is_start", [False, True])
def test_a_lane_of_the_map_leads_into_the_new_lane_beside_it(is_start):
    """A road that narrows from two lanes to one, or widens where traffic comes the other way."""
    line = _line(0, 0, 32)
    joint = Joint(0, not is_start, _end(0, 0, is_start=is_start, name="other"))
    new = _new(line[::-1] if is_start else line, joints=[joint])
    end = _end(0, 3.5, is_start=is_start)
    assert merge_beside(new, [DeadEnd(end)]) == []
    before, after, added = new.lines
    assert new.rows == [0, 0, NO_ROW]
    assert np.array_equal(before[-1], after[0]) and np.isclose(np.ptp(before[:, 0]) + np.ptp(after[:, 0]), 32)
    assert np.array_equal(added[-1 if is_start else 0], end.place)
    assert sorted(new.edges) == ([(0, 1), (0, 2)] if is_start else [(0, 1), (2, 1)])
    assert np.array_equal(added[0], before[-1]) if is_start else np.array_equal(added[-1], after[0])
    assert not len(kinks_of(added)) and abs(wrap_to_pi((outward_heading(added, not is_start) or 0.0) - np.pi)) < 0.2
    joints = {(one.lane, one.at_start, one.open_end.lane_id) for one in new.joints}
    assert joints == {(2, not is_start, "known"), (1 if is_start else 0, not is_start, "other")}


def test_a_lane_leads_into_the_start_of_a_lane_ahead_that_nothing_precedes():
    new = _new(_line(8, 1, 32))
    assert merge_beside(new, [DeadEnd(_end(0, 0))]) == [] and new.edges == [(1, 0)] and len(new.lines) == 2


def test_a_new_lane_that_ends_inside_leads_into_the_one_beside():
    new = _new(_line(0, 0, 32), _line(0, 3, 8))
    end = OpenEnd("", False, new.lines[1][-1], 0.0, False)
    assert merge_beside(new, [DeadEnd(end, 1)]) == []
    assert sorted(new.edges) == [(0, 2), (1, 3), (3, 2)] and new.joints == []


@pytest.mark.parametrize(
    "other",
    [_line(32, 3.5, 0), _line(0, 9, 32), _line(0, 3.5, 6), _line(10, -9, 10, 9), _line(-30, 3.5, -2)],
    ids=["oncoming", "far aside", "too short", "across", "behind"],
)
def test_lanes_elsewhere_are_not_merged_into(other):
    new, dead = _new(other, joints=[Joint(0, True, _end(0, 3.5))]), [DeadEnd(_end(0, 0))]
    assert merge_beside(new, dead) == dead and len(new.lines) == 1 and new.edges == []


@pytest.mark.parametrize("is_start", [False, True])
def test_lanes_go_on_to_a_border_that_is_near(is_start):
    new = _new(_line(0, 0, 10)[::-1] if is_start else _line(0, 0, 10))
    ends = [DeadEnd(_end(10, 0, is_start=is_start), 0), DeadEnd(_end(10, 9, is_start=is_start))]
    assert reach_border(new, ends, lambda place, outward: place[0] + 2.0 * np.cos(outward) < 14.2) == []
    assert [sorted(line[[0, -1], 0]) for line in new.lines] == [[0.0, 12.5], [10.0, 12.5]]
    assert [(one.lane, one.at_start) for one in new.joints] == [(1, not is_start)]


def test_lanes_far_from_a_border_stay_dead():
    new, ends = _new(_line(0, 0, 10)), [DeadEnd(_end(10, 0), 0)]
    assert reach_border(new, ends, lambda place, outward: place[0] < 20) == ends and new.lines[0][-1, 0] == 10
