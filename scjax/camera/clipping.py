"""Clipping of segments and polygons in float64: to a range of depths, a disc, a rectangle, a half-space.

Segments are given by both ends. Results are shares of the way from the first end to the second, so that what varies
along a segment can follow. A segment without a visible part has an empty range: ``stop < start``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

_FLAT = 1e-12  # a segment that changes less runs along the border


class VisiblePart(NamedTuple):
    """The visible part of each segment, as shares of its length; ``keep`` where there is one."""

    start: Float64[np.ndarray, " n"]
    stop: Float64[np.ndarray, " n"]

    @property
    def keep(self) -> Bool[np.ndarray, " n"]:
        """Whether some of the segment is visible; a point on the border is."""
        return self.start <= self.stop

    def cut(
        self, first: Float64[np.ndarray, "n ..."], second: Float64[np.ndarray, "n ..."]
    ) -> Float64[np.ndarray, "n 2 ..."]:
        """Values at both ends of the visible parts, of values at both ends of the segments."""
        axes = (1,) * (first.ndim - 1)
        change = second - first
        start = first + self.start.reshape(-1, *axes) * change
        # From the nearer end, so that an end that stays is not rounded.
        stop = second - (1 - self.stop).reshape(-1, *axes) * change
        return np.stack([start, stop], 1)


def clip_depth(
    first: Float64[np.ndarray, " n"], second: Float64[np.ndarray, " n"], near: float, far: float
) -> VisiblePart:
    """The part of each segment with ``near`` <= depth <= ``far``, of the depths of its ends [m]."""
    part = VisiblePart(np.zeros(len(first)), np.ones(len(first)))
    part = _above(part, first - near, second - near)
    return _above(part, far - first, far - second)


def clip_rectangle(
    first: Float64[np.ndarray, "n 2"],
    second: Float64[np.ndarray, "n 2"],
    low: tuple[float, float],
    high: tuple[float, float],
) -> VisiblePart:
    """The part of each segment inside a rectangle of the plane (Liang and Barsky, 1984)."""
    part = VisiblePart(np.zeros(len(first)), np.ones(len(first)))
    for axis in (0, 1):
        part = _above(part, first[:, axis] - low[axis], second[:, axis] - low[axis])
        part = _above(part, high[axis] - first[:, axis], high[axis] - second[:, axis])
    return part


def clip_disc(first: Float64[np.ndarray, "n 2"], second: Float64[np.ndarray, "n 2"], radius: float) -> VisiblePart:
    """The part of each segment inside a disc around the origin."""
    change = second - first
    square = (change * change).sum(-1)
    middle = -(first * change).sum(-1)
    distance = (first * first).sum(-1) - radius**2
    root = middle * middle - square * distance
    half = np.sqrt(np.maximum(root, 0))
    moving = square > _FLAT**2
    safe = np.where(moving, square, 1.0)
    outside = np.where(moving, root < 0, distance > 0)
    start = np.where(moving, (middle - half) / safe, 0.0).clip(0, None)
    stop = np.where(moving, (middle + half) / safe, 1.0).clip(None, 1)
    return VisiblePart(np.where(outside, 1.0, start), np.where(outside, 0.0, stop))


def _above(part: VisiblePart, first: np.ndarray, second: np.ndarray) -> VisiblePart:
    """``part`` cut to where a value that goes from ``first`` to ``second`` is not negative."""
    change = second - first
    flat = np.abs(change) < _FLAT
    share = -first / np.where(flat, 1.0, change)
    start = np.where(~flat & (change > 0), np.maximum(part.start, share), part.start)
    stop = np.where(~flat & (change < 0), np.minimum(part.stop, share), part.stop)
    outside = flat & (np.maximum(first, second) < 0)
    return VisiblePart(np.where(outside, 1.0, start), np.where(outside, 0.0, stop))


def clip_polygons(
    polygons: Float64[np.ndarray, "n corners dims"], normal: Float64[np.ndarray, " dims"], offset: float
) -> Float64[np.ndarray, "n more dims"]:
    """The part of each convex polygon where ``normal`` . x >= ``offset`` (Sutherland and Hodgman, 1974).

    The result has one corner more; the last one is repeated where there are fewer. Polygons without a visible part are
    NaN. Repeated corners, also of the arguments, change nothing; NaN polygons stay NaN.
    """
    height = polygons @ normal - offset
    whole = (height >= 0).all(1)
    result = np.concatenate([polygons, polygons[:, -1:]], 1)
    if not whole.all():
        result[~whole] = _cut_polygons(polygons[~whole], height[~whole])
    return result


def _cut_polygons(polygons: np.ndarray, height: np.ndarray) -> np.ndarray:
    """The part of each polygon where its corners' height, linear in between, is not negative."""
    count, corners, dims = polygons.shape
    follower, next_height = np.roll(polygons, -1, 1), np.roll(height, -1, 1)
    inside = height >= 0
    crosses = inside != (next_height >= 0)
    share = height / np.where(crosses, height - next_height, 1.0)
    crossing = polygons + share[..., None] * (follower - polygons)
    slots = np.stack([polygons, crossing], 2).reshape(count, 2 * corners, dims)
    used = np.stack([inside, crosses & np.isfinite(share)], 2).reshape(count, 2 * corners)
    order = np.argsort(~used, axis=1, kind="stable")[:, : corners + 1]
    last = np.maximum(used.sum(1) - 1, 0)
    order = np.where(
        np.arange(corners + 1) <= last[:, None], order, np.take_along_axis(order, last[:, None].clip(max=corners), 1)
    )
    result = np.take_along_axis(slots, order[..., None], 1)
    result[~used.any(1)] = np.nan
    return result
