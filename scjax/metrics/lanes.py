"""Lane centerlines as segments: nearest segment to a point, and points along lanes (NumPy, float64)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from scjax.scene import Scene


def lane_segments(scene: Scene) -> Float64[np.ndarray, "segments 2 3"]:
    """Start and end of every segment of every lane of one scene, in driving order [m]."""
    lanes = np.asarray(scene.lanes, np.float64)[np.asarray(scene.lane_mask)]
    return np.stack([lanes[:, :-1], lanes[:, 1:]], 2).reshape(-1, 2, 3)


def nearest_segment(
    points: Float[np.ndarray, "points 2"], segments: Float64[np.ndarray, "segments 2 3"]
) -> tuple[Float64[np.ndarray, " points"], Float64[np.ndarray, " points"]]:
    """Distance in the plane to the nearest segment [m] and its heading [rad]; inf and 0 without segments."""
    if not len(segments) or not len(points):
        return np.full(len(points), np.inf), np.zeros(len(points))
    start, along = segments[:, 0, :2], segments[:, 1, :2] - segments[:, 0, :2]
    square = (along**2).sum(-1)
    offset = np.asarray(points, np.float64)[:, None] - start
    share = np.clip((offset * along).sum(-1) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    distance = np.linalg.norm(offset - share[..., None] * along, axis=-1)
    # A segment of zero length has no heading: prefer a neighbor with the same point.
    best = np.where(square > 0, distance, distance + 1e-9).argmin(-1)
    return distance[np.arange(len(points)), best], np.arctan2(along[best, 1], along[best, 0])


def points_along(
    segments: Float64[np.ndarray, "segments 2 3"], arc: Float64[np.ndarray, " points"]
) -> tuple[Float64[np.ndarray, "points 3"], Float64[np.ndarray, "points 2"]]:
    """Points and unit directions at xy arc lengths ``arc`` [m] along the chain of all segments."""
    along = segments[:, 1] - segments[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    end = np.cumsum(length)
    row = np.minimum(np.searchsorted(end, arc, side="right"), len(segments) - 1)
    row = np.minimum(row, np.flatnonzero(length > 0).max(initial=0))
    share = np.clip((arc - (end[row] - length[row])) / np.where(length[row] > 0, length[row], 1.0), 0.0, 1.0)
    direction = along[row, :2] / np.maximum(length[row], 1e-12)[:, None]
    return segments[row, 0] + share[:, None] * along[row], direction


def lane_arc_lengths(scene: Scene) -> Float64[np.ndarray, " lanes"]:
    """xy arc length of every lane of one scene [m]."""
    lanes = np.asarray(scene.lanes, np.float64)[np.asarray(scene.lane_mask), :, :2]
    return np.linalg.norm(np.diff(lanes, axis=1), axis=-1).sum(-1)
