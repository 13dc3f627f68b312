"""Batched polylines with equally many points (xy, float64): lengths and resampling."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64


def polyline_lengths(points: Float64[np.ndarray, "lines points 2"]) -> Float64[np.ndarray, " lines"]:
    """Arc length of each line [m]."""
    return _steps(points).sum(-1)


def resample_polylines(
    points: Float64[np.ndarray, "lines points 2"], count: int
) -> Float64[np.ndarray, "lines count 2"]:
    """``count`` equally spaced points along each line, bit for bit as ``np.interp`` over the arc length.

    Exact bits matter: where two lanes share a point, rounding decides which of them is nearest to a vehicle.
    """
    if not len(points):
        return np.zeros((0, count, 2))
    arc = np.concatenate([np.zeros((len(points), 1)), np.cumsum(_steps(points), -1)], -1)
    at = np.linspace(0.0, arc[:, -1], count, axis=-1)
    row = np.minimum((arc[:, None, 1:] <= at[..., None]).sum(-1), points.shape[1] - 2)[..., None]
    start, end = (np.take_along_axis(points, row + k, 1) for k in (0, 1))
    from_, to = (np.take_along_axis(arc, row[..., 0] + k, 1)[..., None] for k in (0, 1))
    slope = np.divide(end - start, to - from_, out=np.zeros_like(start), where=to > from_)
    inner = slope * (at[..., None] - from_) + start
    return np.where((at >= arc[:, -1:])[..., None], points[:, -1:], inner)


def _steps(points: np.ndarray) -> np.ndarray:
    return np.sqrt(np.square(np.diff(points, axis=1)).sum(-1))
