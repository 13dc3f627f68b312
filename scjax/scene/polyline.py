"""A polyline at equal steps of arc length, on the host; ``scjax.scene.geometry.resample`` is the one for networks."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64


def resample_polyline(points: Float64[np.ndarray, "points 3"], count: int) -> Float64[np.ndarray, "count 3"]:
    """``count`` points equally spaced in xy arc length; z is linear in the same parameter. The ends stay in place."""
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    keep = np.concatenate([[True], steps > 0])
    points, arc = points[keep], np.concatenate([[0.0], np.cumsum(steps)])[keep]
    target = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(target, arc, column) for column in points.T], -1)
