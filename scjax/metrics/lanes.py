"""Centrelines as segments: the nearest one to a point, and places along them. Exact, in float64 on the host."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from scjax.scene import Scene


def segments(scene: Scene) -> Float64[np.ndarray, "segments 2 3"]:
    """Start and end of every piece of every real lane of one scene, lane by lane in driving direction [m]."""
    lanes = np.asarray(scene.lanes, np.float64)[np.asarray(scene.lane_mask)]
    return np.stack([lanes[:, :-1], lanes[:, 1:]], 2).reshape(-1, 2, 3)


def nearest_segment(
    points: Float[np.ndarray, "points 2"], pieces: Float64[np.ndarray, "segments 2 3"]
) -> tuple[Float64[np.ndarray, " points"], Float64[np.ndarray, " points"]]:
    """Exact distance in the plane to the nearest segment [m], inf without any, and its heading [rad], 0 without any."""
    if not len(pieces) or not len(points):
        return np.full(len(points), np.inf), np.zeros(len(points))
    start, along = pieces[:, 0, :2], pieces[:, 1, :2] - pieces[:, 0, :2]
    square = (along**2).sum(-1)
    offset = np.asarray(points, np.float64)[:, None] - start
    share = np.clip((offset * along).sum(-1) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    distance = np.linalg.norm(offset - share[..., None] * along, axis=-1)
    # A piece of no length has no heading: a neighbour that shares its point goes first.
    best = np.where(square > 0, distance, distance + 1e-9).argmin(-1)
    return distance[np.arange(len(points)), best], np.arctan2(along[best, 1], along[best, 0])


def places(
    pieces: Float64[np.ndarray, "segments 2 3"], arc: Float64[np.ndarray, " places"]
) -> tuple[Float64[np.ndarray, "places 3"], Float64[np.ndarray, "places 2"]]:
    """Points and unit directions in the plane at xy arc lengths ``arc`` [m] along all segments, one after the other."""
    along = pieces[:, 1] - pieces[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    end = np.cumsum(length)
    row = np.minimum(np.searchsorted(end, arc, side="right"), len(pieces) - 1)
    row = np.minimum(row, np.flatnonzero(length > 0).max(initial=0))
    share = np.clip((arc - (end[row] - length[row])) / np.where(length[row] > 0, length[row], 1.0), 0.0, 1.0)
    direction = along[row, :2] / np.maximum(length[row], 1e-12)[:, None]
    return pieces[row, 0] + share[:, None] * along[row], direction


def lane_lengths(scene: Scene) -> Float64[np.ndarray, " lanes"]:
    """xy arc length of every real lane of one scene [m]."""
    lanes = np.asarray(scene.lanes, np.float64)[np.asarray(scene.lane_mask), :, :2]
    return np.linalg.norm(np.diff(lanes, axis=1), axis=-1).sum(-1)
