"""Lines on the road as segments: centers of lanes, and borders of the road."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import MapLane
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.scene.polyline import spread_lines

LANE_WIDTH = 3.5  # m; maps hold no widths
_TOLERANCE = 0.02  # m between a line and its simplified form
_LONGEST = 8.0  # m; the brightness of a line changes with its depth segment by segment
_BORDER_SPACING = 1.0  # m between points of borders
_PROBE = 2.5  # m from the center of a lane; other lanes there make its side no border of the road
_HITS = 6  # nearest points of lanes that are looked at
_STOREY = 2.5  # m; lanes farther apart in height are on different roads


@dataclasses.dataclass(frozen=True)
class RoadSegments:
    """Straight pieces of lines.

    Attributes:
      first, second: ends [m]; z is NaN where the map has none.
      lanes: index of the lane of each piece.
    """

    first: Float64[np.ndarray, "n 3"]
    second: Float64[np.ndarray, "n 3"]
    lanes: Int[np.ndarray, " n"]


def center_line_segments(lanes: Sequence[MapLane]) -> RoadSegments:
    """Centers of all lanes, with no more points than needed to show their shape."""
    lines = [(row, simplified(lane.points)) for row, lane in enumerate(lanes) if len(lane.points) > 1]
    return _segments(lines)


def border_segments(lanes: Sequence[MapLane]) -> RoadSegments:
    """Borders of the road: sides of lanes for cars beside which no other lane lies."""
    lines = [
        (side.lane, simplified(run)) for side in lane_sides(lanes) for run in _runs(side.points, side.beside == OUTSIDE)
    ]
    return _segments(lines)


OUTSIDE, SAME_WAY, OTHER_WAY, CROSSING = range(4)
"""What lies beside a lane: no lane, one that goes the same way, the other way, or that crosses."""

_CROSSING = 0.7  # cosine of the angle between lanes, below which they cross


class LaneSide(NamedTuple):
    """One side of a lane.

    Attributes:
      lane: index of the lane.
      is_left: whether it is the left side.
      points: along the side [m]; z is NaN where the map has none.
      beside: what lies beyond it at each point.
    """

    lane: int
    is_left: bool
    points: Float64[np.ndarray, "points 3"]
    beside: Int[np.ndarray, " points"]


def lane_sides(lanes: Sequence[MapLane], width: float = LANE_WIDTH) -> list[LaneSide]:
    """Both sides of all lanes for cars, and what lies beside them.

    A place half a lane beyond a side belongs to another lane whose center is less than half a width away from it.
    """
    cars = [row for row, lane in enumerate(lanes) if lane.lane_type not in NO_CAR_LANE_TYPES and len(lane.points) > 1]
    if not cars:
        return []
    points, counts = spread_lines([lanes[row].points for row in cars], _BORDER_SPACING)
    points = points[np.repeat(counts > 1, counts)]
    numbers, counts = np.array(cars)[counts > 1], counts[counts > 1]
    if not len(numbers):
        return []
    from scipy.spatial import KDTree

    rows, left = np.repeat(numbers, counts), _left(points, counts)
    tree, heights = KDTree(points[:, :2]), np.nan_to_num(points[:, 2])
    ends = np.cumsum(counts)[:-1]
    sides = []
    for sign in (1.0, -1.0):
        distance, hits = tree.query(points[:, :2] + sign * _PROBE * left, k=_HITS, distance_upper_bound=width / 2)
        found = np.isfinite(distance)
        hits = np.where(found, hits, 0)
        found &= (rows[hits] != rows[:, None]) & (np.abs(heights[hits] - heights[:, None]) < _STOREY)
        first = found.argmax(1)
        along = (left * left[hits[np.arange(len(hits)), first]]).sum(-1)  # lefts are as far apart as the ways
        beside = np.select(
            [~found.any(1), along > _CROSSING, along < -_CROSSING], [OUTSIDE, SAME_WAY, OTHER_WAY], CROSSING
        )
        edges = points.copy()
        edges[:, :2] += sign * width / 2 * left
        parts = zip(numbers.tolist(), np.split(edges, ends), np.split(beside, ends), strict=True)
        sides += [LaneSide(row, sign > 0, edge, kinds) for row, edge, kinds in parts]
    return sides


def simplified(line: Float64[np.ndarray, "points 3"], tolerance: float = _TOLERANCE) -> Float64[np.ndarray, "fewer 3"]:
    """The points of a polyline that keep it within ``tolerance`` [m] (Douglas and Peucker, 1973)."""
    flat = np.nan_to_num(line)
    keep = np.zeros(len(line), bool)
    keep[[0, -1]] = True
    stack = [(0, len(line) - 1)]
    while stack:
        low, high = stack.pop()
        if high - low < 2:
            continue
        along = flat[high] - flat[low]
        offset = flat[low + 1 : high] - flat[low]
        square = float(along @ along)
        share = ((offset @ along) / square).clip(0, 1) if square > 0 else np.zeros(len(offset))
        distance = np.linalg.norm(offset - share[:, None] * along, axis=-1)
        worst = int(distance.argmax())
        if distance[worst] > tolerance:
            middle = low + 1 + worst
            keep[middle] = True
            stack += [(low, middle), (middle, high)]
    return line[keep]


def _left(points: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Mitred directions to the left of each point of lines [n, 2]: offsets along them give parallel lines.

    Args:
      counts: of the points of each line, at least two.
    """
    steps = np.diff(points[:, :2], axis=0)
    steps = steps / np.maximum(np.linalg.norm(steps, axis=-1, keepdims=True), 1e-9)
    before, after = np.concatenate([steps[:1], steps]), np.concatenate([steps, steps[-1:]])
    last = np.cumsum(counts) - 1
    before[last + 1 - counts], after[last] = steps[last + 1 - counts], steps[last - 1]
    middle = before + after
    square = (middle * middle).sum(-1, keepdims=True)
    # |middle|^2 / 2 = 1 + cos(turn); the miter is limited where a line turns back.
    middle = np.where(square > 0.5, 2 * middle / np.maximum(square, 0.5), after)
    return np.stack([-middle[:, 1], middle[:, 0]], -1)


def _runs(line: np.ndarray, keep: np.ndarray) -> list[np.ndarray]:
    """Parts of a line whose points are all kept; single points are no part."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], keep, [False]]).astype(int)))
    return [line[start:stop] for start, stop in edges.reshape(-1, 2) if stop - start > 1]


def _segments(lines: list[tuple[int, np.ndarray]]) -> RoadSegments:
    """Lines as segments of at most ``_LONGEST``; segments of no length are left out."""
    if not lines:
        return RoadSegments(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, int))
    first = np.concatenate([line[:-1] for _, line in lines])
    second = np.concatenate([line[1:] for _, line in lines])
    lanes = np.concatenate([np.full(len(line) - 1, row) for row, line in lines])
    lengths = np.hypot(*(second - first)[:, :2].T)
    counts = np.where(lengths > 1e-6, np.ceil(lengths / _LONGEST), 0).astype(int)
    index = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
    change = second - first
    share = number / counts[index], (number + 1) / counts[index]
    return RoadSegments(
        first[index] + share[0][:, None] * change[index], first[index] + share[1][:, None] * change[index], lanes[index]
    )
