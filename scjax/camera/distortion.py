"""Lens distortion by three radial and two tangential numbers (k1, k2, p1, p2, k3), as in OpenCV.

With r the distance of an ideal point from the axis, the radial part is r (1 + k1 r^2 + k2 r^4 + k3 r^6). It grows with
r only up to a first root of its slope. Beyond it points would fold back into the picture, so they count as not visible.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float64

NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
_ROUNDS = 6  # of Newton's method
_TABLE = 4096  # distances from the axis


def distort(points: Float64[np.ndarray, "*b 2"], distortion: Float64[np.ndarray, " 5"]) -> Float64[np.ndarray, "*b 2"]:
    """Where a lens shows the ideal points x / z, y / z; both at depth 1."""
    k1, k2, p1, p2, k3 = distortion.tolist()
    x, y = points[..., 0], points[..., 1]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    cross = 2 * x * y
    return np.stack(
        [
            x * radial + p1 * cross + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + p2 * cross,
        ],
        -1,
    )


def undistort(
    points: Float64[np.ndarray, "*b 2"], distortion: Float64[np.ndarray, " 5"]
) -> Float64[np.ndarray, "*b 2"]:
    """The ideal points that a lens shows at ``points``; those that no point inside ``max_radius`` reaches are NaN.

    Newton's method, from the solution without the tangential part.
    """
    k1, k2, p1, p2, k3 = distortion.tolist()
    radius = np.hypot(points[..., 0], points[..., 1])
    ideal = points * (undistorted_radius(radius, distortion) / np.maximum(radius, 1e-12))[..., None]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(_ROUNDS):
            x, y = ideal[..., 0], ideal[..., 1]
            square = x * x + y * y
            radial = 1 + square * (k1 + square * (k2 + square * k3))
            slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
            xx = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
            xy = x * y * slope + 2 * p1 * x + 2 * p2 * y
            yy = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
            error = distort(ideal, distortion) - points
            dx, dy = error[..., 0], error[..., 1]
            step = np.stack([yy * dx - xy * dy, xx * dy - xy * dx], -1) / (xx * yy - xy * xy)[..., None]
            ideal = ideal - step
        error = np.abs(distort(ideal, distortion) - points).max(-1)
        wrong = ~(error < 1e-9) | ~(np.hypot(ideal[..., 0], ideal[..., 1]) <= max_radius(distortion))
    ideal[wrong] = np.nan
    return ideal


def undistorted_radius(
    radius: Float64[np.ndarray, "*b"], distortion: Float64[np.ndarray, " 5"]
) -> Float64[np.ndarray, "*b"]:
    """The ideal distance from the axis that the radial part shows at ``radius``, by a table; at most ``max_radius``."""
    k1, k2, _, _, k3 = distortion.tolist()
    ideal = np.linspace(0.0, min(max_radius(distortion), 4 * float(radius.max(initial=0.0)) + 1.0), _TABLE)
    square = ideal * ideal
    return np.interp(radius, ideal * (1 + square * (k1 + square * (k2 + square * k3))), ideal)


def max_radius(distortion: Float64[np.ndarray, " 5"]) -> float:
    """The first root of the slope of the radial part: the largest visible r; inf if there is none."""
    k1, k2, _, _, k3 = distortion.tolist()
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    squares = [root.real for root in roots if abs(root.imag) < 1e-9 * max(1.0, abs(root)) and root.real > 0]
    return math.sqrt(min(squares)) if squares else math.inf
