"""Polylines by arc length, on the host; ``scjax.scene.geometry`` has the functions for networks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int


def cumulative_length(points: Float64[np.ndarray, "points _"]) -> Float64[np.ndarray, " points"]:
    """Arc length in xy from the start to each point [m]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])


def thinned(points: Float64[np.ndarray, "points dims"], least: float) -> Float64[np.ndarray, "n dims"]:
    """A line of which points are at least ``least`` apart, unless it is shorter; both its ends stay [m]."""
    arc, rows = cumulative_length(points), [0]
    for row in range(1, len(points) - 1):
        if arc[row] - arc[rows[-1]] >= least and arc[-1] - arc[row] >= least:
            rows.append(row)
    return points[[*rows, len(points) - 1]]


def spread_points(points: Float64[np.ndarray, "points dims"], spacing: float = 1.0) -> Float64[np.ndarray, "n dims"]:
    """Points along a polyline at this spacing in xy arc length [m]; the last one is its end."""
    arc = cumulative_length(points)
    target = np.arange(0.0, arc[-1] + spacing, spacing)
    return np.stack([np.interp(target, arc, column) for column in points.T], -1)


def spread_lines(
    lines: Sequence[Float64[np.ndarray, "points dims"]], spacing: float = 1.0
) -> tuple[Float64[np.ndarray, "n dims"], Int[np.ndarray, " lines"]]:
    """``spread_points`` of several lines, one after the other, and how many there are of each; much faster for many."""
    points = np.concatenate(lines)
    sizes = np.array([len(line) for line in lines])
    starts = np.cumsum(sizes) - sizes
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    steps[starts[1:] - 1] = 0.0
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    lengths = np.round(arc[starts + sizes - 1] - arc[starts], 9)
    arc += np.repeat(np.arange(len(lines)), sizes)  # so that lines do not touch
    counts = np.maximum(np.ceil((lengths + spacing) / spacing).astype(int), 1)
    first, last = np.repeat(arc[starts], counts), np.repeat(arc[starts + sizes - 1], counts)
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    target = np.minimum(first + spacing * number, last)
    return np.stack([np.interp(target, arc, column) for column in points.T], -1), counts


def point_headings(points: Float64[np.ndarray, "points _"]) -> Float64[np.ndarray, " points"]:
    """Direction of a line in xy at each of its points [rad]; 0 for a single point."""
    if len(points) < 2:
        return np.zeros(len(points))
    x, y = np.gradient(points[:, :2], axis=0).T
    return np.arctan2(y, x)


def smoothstep(t: np.ndarray) -> np.ndarray:
    """Cubic step from 0 at ``t`` <= 0 to 1 at ``t`` >= 1, with slope 0 at both ends."""
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def resample_polyline(points: Float64[np.ndarray, "points 3"], count: int) -> Float64[np.ndarray, "count 3"]:
    """``count`` points equally spaced in xy arc length; z is linear in the same parameter. The ends stay in place."""
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    keep = np.concatenate([[True], steps > 0])
    points, arc = points[keep], np.concatenate([[0.0], np.cumsum(steps)])[keep]
    target = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(target, arc, column) for column in points.T], -1)
