"""Which lanes of a new tile continue which open ends of the map, and which are there already."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64

from scjax.outpainting.bends import MAX_BEND, SAME_PLACE, Joint
from scjax.outpainting.coverage import OpenEnd, outward_heading
from scjax.scene.angles import wrap_to_pi
from scjax.scene.polyline import cumulative_length, spread_points

MAX_GAP = 2.5
"""m between ends that may be joined, before one is moved to the other."""

MAX_TURN = np.deg2rad(60.0)
"""Change of direction at a joint, at most, before one is turned to the other."""

_SPLIT_GAP, _SPLIT_TURN = 1.0, np.deg2rad(30.0)  # of further lanes that begin at a joint
_PAST_END = 0.1  # m beyond the end of a lane, from where nothing is beside it
_NEVER = 1e6  # cost of ends that may not be joined


def find_joints(
    lanes: Sequence[Float64[np.ndarray, "_ 3"]],
    open_ends: Sequence[OpenEnd],
    edges: Sequence[tuple[int, int]] = (),
) -> list[Joint]:
    """Joints between new lanes and open ends: a best assignment, and more where lanes split or merge at the seam.

    Args:
      lanes: new lanes, in the frame of the ends.
      edges: pairs of new lanes, the second of which follows the first; ends with such a neighbor do not split off.
    """
    from scipy.optimize import linear_sum_assignment

    joints = []
    for at_start in (True, False):
        ends = [end for end in open_ends if end.is_start != at_start]
        if not ends or not lanes:
            continue
        gaps, turns = _gaps_and_turns(lanes, ends, at_start)
        possible = (gaps <= MAX_GAP) & (turns < MAX_TURN)
        costs = np.where(possible, gaps / MAX_GAP + turns / MAX_TURN, _NEVER)
        rows, columns = linear_sum_assignment(costs)
        pairs = {(int(row), int(column)) for row, column in zip(rows, columns, strict=True) if possible[row, column]}
        joined = {column for _, column in pairs} | {b if at_start else a for a, b in edges}
        close = (gaps <= _SPLIT_GAP) & (turns < _SPLIT_TURN)
        for column in range(len(lanes)):
            if column not in joined and close[:, column].any():
                pairs.add((int(np.where(close[:, column], costs[:, column], np.inf).argmin()), column))
        left = set(range(len(ends))) - {row for row, _ in pairs}
        pairs |= {(row, column) for one, column in pairs for row in left if _is_same_place(ends[one], ends[row])}
        joints += [Joint(column, at_start, ends[row]) for row, column in sorted(pairs)]
    return joints


def _is_same_place(one: OpenEnd, other: OpenEnd) -> bool:
    """Whether two lanes of the map split or merge at their open ends."""
    turn = abs(wrap_to_pi(one.outward - other.outward))
    return bool(np.hypot(*(one.place - other.place)[:2]) < SAME_PLACE and turn < MAX_BEND)


def _gaps_and_turns(
    lanes: Sequence[Float64[np.ndarray, "_ 3"]], ends: Sequence[OpenEnd], at_start: bool
) -> tuple[Float64[np.ndarray, "ends lanes"], Float64[np.ndarray, "ends lanes"]]:
    """Distances between open ends and the starts or ends of lanes [m], and changes of direction there [rad]."""
    places = np.array([lane[0 if at_start else -1, :2] for lane in lanes])
    outward = np.array([outward_heading(lane, at_start) or 0.0 for lane in lanes])
    known = np.array([end.place[:2] for end in ends])
    gaps = np.hypot(*np.moveaxis(known[:, None] - places[None], -1, 0))
    headings = np.array([end.outward for end in ends])
    turns = np.abs(wrap_to_pi(headings[:, None] - outward[None] - np.pi))
    return gaps, turns


def is_duplicate(
    points: Float64[np.ndarray, "points 3"], others: Sequence[Float64[np.ndarray, "_ 3"]]
) -> Bool[np.ndarray, " others"]:
    """Whether a lane runs along each of ``others``: within 1 m and 20 degrees for 70 % of the shorter one."""
    result = np.zeros(len(others), bool)
    for row in np.flatnonzero(_bounds_meet(points, others)).tolist():
        other = others[row]
        one, two = sorted((points, other), key=lambda line: cumulative_length(line)[-1])
        low, high = two[:, :2].min(0) - 1.0, two[:, :2].max(0) + 1.0
        inside = ((one[:, :2] > low) & (one[:, :2] < high)).all(-1)
        if inside.mean() < 0.5:
            continue
        points_one, points_two = spread_points(one)[:, :2], spread_points(two)[:, :2]
        near = np.hypot(*np.moveaxis(points_one[:, None] - points_two[None], -1, 0))
        column = near.argmin(1)
        headings = _headings(points_two)[column]
        turn = np.abs(wrap_to_pi(_headings(points_one) - headings))
        ahead = ((points_one - points_two[column]) * np.stack([np.cos(headings), np.sin(headings)], -1)).sum(-1)
        beside = ((column > 0) & (column < len(points_two) - 1)) | (np.abs(ahead) < _PAST_END)
        result[row] = (beside & (near.min(1) < 1.0) & (turn < np.deg2rad(20.0))).mean() > 0.7
    return result


def _bounds_meet(
    points: Float64[np.ndarray, "points 3"], others: Sequence[Float64[np.ndarray, "_ 3"]]
) -> Bool[np.ndarray, " others"]:
    """Whether the rectangles around lines come within 1 m of that around ``points``."""
    if not len(others):
        return np.zeros(0, bool)
    every = np.concatenate([other[:, :2] for other in others])
    starts = np.cumsum([0, *(len(other) for other in others)])[:-1]
    low, high = np.minimum.reduceat(every, starts), np.maximum.reduceat(every, starts)
    return ((points[:, :2].min(0) < high + 1.0) & (points[:, :2].max(0) > low - 1.0)).all(-1)


def _headings(points: np.ndarray) -> np.ndarray:
    steps = np.gradient(points[:, :2], axis=0) if len(points) > 1 else np.array([[1.0, 0.0]])
    return np.arctan2(steps[:, 1], steps[:, 0])
