"""Which lanes of a new tile continue which open ends of the map, and which are there already."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64

from scjax.outpainting.bends import Joint
from scjax.outpainting.coverage import OpenEnd, outward_heading
from scjax.scene.angles import wrap_to_pi
from scjax.scene.polyline import cumulative_length, spread_points

MAX_GAP = 2.5
"""m between ends that may be joined, before one is moved to the other."""

MAX_TURN = np.deg2rad(60.0)
"""Change of direction at a joint, at most."""

_SPLIT_GAP, _SPLIT_TURN = 1.0, np.deg2rad(30.0)  # of further lanes that begin at a joint
_NEVER = 1e6  # cost of ends that may not be joined


def find_joints(lanes: Sequence[Float64[np.ndarray, "_ 3"]], open_ends: Sequence[OpenEnd]) -> list[Joint]:
    """Joints between new lanes and open ends: a best assignment, and more lanes where a known one splits or merges.

    Args:
      lanes: new lanes, in the frame of the ends.
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
        joined = {column for _, column in pairs}
        close = (gaps <= _SPLIT_GAP) & (turns < _SPLIT_TURN)
        for column in range(len(lanes)):
            if column not in joined and close[:, column].any():
                pairs.add((int(np.where(close[:, column], gaps[:, column], np.inf).argmin()), column))
        joints += [Joint(column, at_start, ends[row]) for row, column in sorted(pairs)]
    return joints


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
    for row, other in enumerate(others):
        one, two = sorted((points, other), key=lambda line: cumulative_length(line)[-1])
        low, high = two[:, :2].min(0) - 1.0, two[:, :2].max(0) + 1.0
        inside = ((one[:, :2] > low) & (one[:, :2] < high)).all(-1)
        if inside.mean() < 0.5:
            continue
        near = np.hypot(*np.moveaxis(spread_points(one)[:, None, :2] - spread_points(two)[None, :, :2], -1, 0))
        column = near.argmin(1)
        turn = np.abs(wrap_to_pi(_headings(spread_points(one)) - _headings(spread_points(two))[column]))
        result[row] = ((near.min(1) < 1.0) & (turn < np.deg2rad(20.0))).mean() > 0.7
    return result


def _headings(points: np.ndarray) -> np.ndarray:
    steps = np.gradient(points[:, :2], axis=0) if len(points) > 1 else np.array([[1.0, 0.0]])
    return np.arctan2(steps[:, 1], steps[:, 0])
