"""Regions on the ground: boxes and polygons, and which points lie in them."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float64

from scjax.scene.limits import MAX_COORDINATE

_BOX_NUMBERS = 4


def region_polygon(region: Any) -> Float64[np.ndarray, "corners 2"]:
    """Corners of a region [m].

    Args:
      region: a box, (x0, y0, x1, y1), or the corners of a polygon in order, [corners, 2] with three corners or more.

    Raises:
      ValueError: it is neither, or encloses nothing.
    """
    try:
        numbers = np.asarray(region, np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape == (_BOX_NUMBERS,):
        x0, y0, x1, y1 = numbers
        numbers = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    if numbers.ndim != 2 or numbers.shape[1:] != (2,) or len(numbers) < 3:
        raise ValueError(
            "region must be a box (x0, y0, x1, y1) or the corners of a polygon [corners, 2] in meters, "
            f"not {str(region)[:80]!r}"
        )
    if not (np.abs(numbers) < MAX_COORDINATE).all():
        raise ValueError("region holds NaN, infinity or absurd coordinates: give meters in the frame of the scene")
    x, y = numbers.T
    if not abs((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()) > 0:
        raise ValueError("region encloses no area: give corners that differ in x and y")
    return numbers


def inside_polygon(
    points: Float[np.ndarray, "*n 2"], polygon: Float[np.ndarray, "corners 2"]
) -> Bool[np.ndarray, "*n"]:
    """Which points lie in a polygon: a ray from them crosses its border an odd number of times."""
    x, y = (np.asarray(points, np.float64)[..., column, None] for column in (0, 1))
    (x0, y0), (x1, y1) = np.asarray(polygon, np.float64).T, np.roll(polygon, -1, 0).T
    rises = (y0 > y) != (y1 > y)
    crossing = x0 + (y - y0) * (x1 - x0) / np.where(y1 == y0, 1.0, y1 - y0)
    return (rises & (x < crossing)).sum(-1) % 2 == 1
