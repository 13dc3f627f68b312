"""Where lanes cross at one height."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from scjax.export.roads.lane_curves import LaneCurve, curve_line

MAX_STEP = 3.0
"""Height between two lanes of which one is a bridge over the other [m]."""

_MIN_SINE = 0.17  # of the angle between lanes that cross; others run into each other
_AT_END = 0.5  # m from the end of a lane, where it meets others anyway


class LaneCrossing(NamedTuple):
    """Two lanes that cross.

    Attributes:
      lanes: indices.
      arcs: where, on each [m].
      sine: of the angle between them.
    """

    lanes: tuple[int, int]
    arcs: tuple[float, float]
    sine: float


def lane_crossings(curves: Sequence[LaneCurve]) -> list[LaneCrossing]:
    """All crossings of two curves, away from their ends."""
    from scipy.spatial import KDTree

    lines = [curve_line(curve) for curve in curves]
    start = np.concatenate([points[:-1] for points, _ in lines])
    step = np.concatenate([np.diff(points, axis=0) for points, _ in lines])
    arc = np.concatenate([arcs[:-1] for _, arcs in lines])
    width = np.concatenate([np.diff(arcs) for _, arcs in lines])
    lane = np.repeat(np.arange(len(lines)), [len(arcs) - 1 for _, arcs in lines])
    length = np.array([arcs[-1] for _, arcs in lines])
    reach = float(np.hypot(*step[:, :2].T).max())
    pairs = KDTree((start + step / 2)[:, :2]).query_pairs(reach + 1e-6, output_type="ndarray")
    a, b = pairs[lane[pairs[:, 0]] != lane[pairs[:, 1]]].T
    cross = step[a, 0] * step[b, 1] - step[a, 1] * step[b, 0]
    sine = np.abs(cross) / (np.hypot(*step[a, :2].T) * np.hypot(*step[b, :2].T) + 1e-12)
    a, b, cross, sine = (values[sine > _MIN_SINE] for values in (a, b, cross, sine))
    offset = start[b] - start[a]
    s = (offset[:, 0] * step[b, 1] - offset[:, 1] * step[b, 0]) / cross
    t = (offset[:, 0] * step[a, 1] - offset[:, 1] * step[a, 0]) / cross
    rise = np.abs(offset[:, 2] + t * step[b, 2] - s * step[a, 2])
    at = np.stack([arc[a] + s * width[a], arc[b] + t * width[b]])
    inner = (at > _AT_END) & (at < np.stack([length[lane[a]], length[lane[b]]]) - _AT_END)
    hit = (s >= 0) & (s < 1) & (t >= 0) & (t < 1) & (rise < MAX_STEP) & inner.all(0)
    return [
        LaneCrossing((int(lane[a[k]]), int(lane[b[k]])), (float(at[0, k]), float(at[1, k])), float(sine[k]))
        for k in np.flatnonzero(hit)
    ]
