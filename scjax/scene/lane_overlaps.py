"""Places of a map where two lanes lie on each other, as where ways into and out of a roundabout share its circle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from scjax.scene.polyline import cumulative_length

_STEP = 1.0  # m between places that are compared
_WIDTH, _LEVEL = 1.0, 2.5  # m between two lanes in the plane and in height
_LEAST_COSINE = 0.94  # of the angle between their directions
_LENGTH = 8.0  # m that they share


def overlap_places(
    lines: Sequence[Float64[np.ndarray, "_ 3"]], same_end: float = 5.0
) -> Float64[np.ndarray, "places 2"]:
    """Places where two centerlines of one direction lie on each other for 8 m, and neither part nor meet there [m].

    Args:
      same_end: lanes whose starts, or whose ends, are nearer than this part or meet [m].
    """
    from scipy.spatial import KDTree

    tables = [_samples(points) for points in lines]
    owners = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    table = np.concatenate([np.zeros((0, 5)), *tables])
    if not len(table):
        return np.zeros((0, 2))
    i, j = KDTree(table[:, :2]).query_pairs(_WIDTH, output_type="ndarray").reshape(-1, 2).T
    near = (owners[i] != owners[j]) & (np.abs(table[i, 2] - table[j, 2]) < _LEVEL)
    i, j = i[near], j[near]
    along = (table[i, 3:] * table[j, 3:]).sum(-1) > _LEAST_COSINE
    i, j = i[along], j[along]
    ends = np.array([[points[0, :2], points[-1, :2]] for points in lines])
    apart = np.hypot(*np.moveaxis(ends[owners[i]] - ends[owners[j]], -1, 0)).min(1) > same_end
    i, j = i[apart], j[apart]
    pairs, which = np.unique(np.stack([owners[i], owners[j]], -1), axis=0, return_inverse=True)
    shared = np.zeros(len(pairs))
    np.add.at(shared, np.unique(np.stack([which.ravel(), i], -1), axis=0)[:, 0], _STEP)
    return table[np.unique(i[shared[which.ravel()] > _LENGTH]), :2]


def _samples(points: np.ndarray) -> np.ndarray:
    """Places about a meter apart: x, y, z and the direction there [places, 5]."""
    arcs = cumulative_length(points)
    places = np.linspace(0.0, arcs[-1], max(int(arcs[-1] / _STEP), 1) + 1)
    xyz = np.stack([np.interp(places, arcs, column) for column in points.T], -1)
    step = np.gradient(xyz[:, :2], axis=0)
    return np.column_stack([xyz, step / np.maximum(np.hypot(*step.T), 1e-9)[:, None]])
