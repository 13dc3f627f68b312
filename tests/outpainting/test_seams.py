"""Joints at seams: who belongs together, and what is there already."""

from __future__ import annotations

import itertools

import numpy as np

from scjax.outpainting.coverage import OpenEnd
from scjax.outpainting.seams import find_joints, is_duplicate


def _line(*points):
    corners = np.array([(*point, 0.0) for point in points], np.float64)
    return np.stack([np.linspace(a, b, 20) for a, b in itertools.pairwise(corners)]).reshape(-1, 3)


def _end(x, y, heading=0.0, name="known", is_start=False):
    return OpenEnd(name, is_start, np.array([x, y, 0.0]), heading, True)


def test_joints_are_the_best_assignment_and_one_to_one():
    lanes = [_line((0.3, 3.4), (30, 3.4)), _line((0.2, -0.2), (30, 0)), _line((30, 7), (0.1, 7))]
    ends = [_end(0, 0, name="a"), _end(0, 3.5, name="b"), _end(0, 7, name="c", is_start=True), _end(0, -9, name="d")]
    joints = {(joint.lane, joint.at_start, joint.open_end.lane_id) for joint in find_joints(lanes, ends)}
    assert joints == {(1, True, "a"), (0, True, "b"), (2, False, "c")}


def test_lanes_that_split_share_an_end():
    lanes = [_line((0, 0), (30, 0)), _line((0, 0), (20, 10))]
    assert {joint.lane for joint in find_joints(lanes, [_end(0, 0)])} == {0, 1}


def test_lanes_too_far_away_or_across_are_not_joined():
    lanes = [_line((3.0, 0), (30, 0)), _line((0, 0.5), (0, 30))]
    assert find_joints(lanes, [_end(0, 0)]) == []
    assert find_joints([], [_end(0, 0)]) == [] == find_joints(lanes, [])


def test_duplicates_run_along_a_lane_in_its_direction():
    lane = _line((0, 0), (40, 0))
    others = [
        _line((5, 0.4), (35, 0.4)),
        _line((35, 0.4), (5, 0.4)),
        _line((0, 3.5), (40, 3.5)),
        _line((90, 0), (99, 0)),
    ]
    assert is_duplicate(lane, others).tolist() == [True, False, False, False]
