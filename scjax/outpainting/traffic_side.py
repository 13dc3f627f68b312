"""The side of the road on which traffic keeps, and lanes that are on the other one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene.polyline import spread_points

_NEAR, _APART = 6.0, 1.0  # m across, at most and at least, between a lane and the oncoming one beside it
_LEVEL = 2.0  # m of height between them, at most
_OPPOSITE = np.cos(np.deg2rad(160.0))
_CLEAR = 5  # m, by which a lane has to be more on one side than on the other

Lines = Sequence[Float64[np.ndarray, "points 3"]]


def oncoming_lengths(lines: Lines) -> Int[np.ndarray, "lines 2"]:
    """Meters of each line with an oncoming one on its left, and on its right."""
    from scipy.spatial import KDTree

    lengths = np.zeros((len(lines), 2), int)
    spread = [spread_points(line) for line in lines]
    long = [row for row, points in enumerate(spread) if len(points) > 2]
    if not long:
        return lengths
    points = np.concatenate([spread[row] for row in long])
    steps = np.concatenate([np.gradient(spread[row][:, :2], axis=0) for row in long])
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    line_of = np.repeat(long, [len(spread[row]) for row in long])
    pairs = KDTree(points[:, :2]).query_pairs(_NEAR, output_type="ndarray")
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    x, y, z = (points[second] - points[first]).T
    cos, sin = np.cos(heading[first]), np.sin(heading[first])
    along, left = x * cos + y * sin, y * cos - x * sin
    is_beside = (np.abs(along) < 0.6) & (np.abs(left) > _APART) & (np.abs(z) < _LEVEL)
    is_beside &= np.cos(heading[first] - heading[second]) < _OPPOSITE
    for column, is_there in enumerate((left > 0, left < 0)):
        places = np.unique(first[is_beside & is_there])
        lengths[:, column] = np.bincount(line_of[places], minlength=len(lines))
    return lengths


def keeps_right(lines: Lines) -> bool | None:
    """Whether traffic keeps to the right on most of these lanes; None if nothing says so."""
    left, right = oncoming_lengths(lines).sum(0).tolist()
    return None if abs(left - right) < _CLEAR else left > right


def on_other_side(lines: Lines, right: bool | None) -> Bool[np.ndarray, " lines"]:
    """Which lanes have oncoming ones on the side that is not for these.

    Args:
      right: whether traffic keeps to the right; None: as on most of the lanes.
    """
    lengths = oncoming_lengths(lines)
    surplus = lengths[:, 0] - lengths[:, 1]
    if right is None:
        right = bool(surplus.sum() >= 0)
    return (-surplus if right else surplus) >= _CLEAR
