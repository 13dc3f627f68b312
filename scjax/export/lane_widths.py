"""Widths of roads: logs have none, so lanes are as wide as usual, or narrower where another one lies beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from scjax.export.crossings import MAX_STEP
from scjax.export.lane_curves import curve_line
from scjax.export.planned_road import PlannedRoad
from scjax.export.traffic import LANE_WIDTH

_LEAST_SHARE = 0.7  # of the usual width
_GAP = 0.1  # m between the borders of two lanes
_STEP = 1.0  # m along a road
_LEAST_APART = 1.5  # m; nearer lanes lie on each other
_PARALLEL = 0.9  # cosine of the angle between lanes that lie beside each other


def road_widths(roads: Sequence[PlannedRoad]) -> Float64[np.ndarray, "roads 2"]:
    """Widths of all roads at their starts and ends [m]; between them they change evenly, and in junctions only."""
    rows = {road.id: row for row, road in enumerate(roads)}
    widths = _outside_widths(roads)
    is_stable = False
    while not is_stable:  # roads that follow each other have one width
        is_stable = True
        for row, road in enumerate(roads):
            after = rows.get(road.after)
            if after is not None and not road.junction and not roads[after].junction:
                least = min(widths[row], widths[after])
                is_stable &= widths[row] == widths[after]
                widths[row] = widths[after] = least
    ends = np.stack([widths, widths], -1)
    for row, road in enumerate(roads):
        if road.junction:
            ends[row] = [widths[rows[id]] if id in rows else LANE_WIDTH for id in (road.before, road.after)]
    return ends


def _outside_widths(roads: Sequence[PlannedRoad]) -> np.ndarray:
    """One width for each road outside of junctions: the usual one times the least share that its neighbors leave."""
    from scipy.spatial import KDTree

    widths = np.full(len(roads), LANE_WIDTH)
    outside = [row for row, road in enumerate(roads) if not road.junction]
    lines = [curve_line(roads[row].curve, _STEP)[0] for row in outside]
    if not lines:
        return widths
    steps = [np.gradient(line[:, :2], axis=0) for line in lines]
    points, ways = np.concatenate(lines), np.concatenate(steps)
    ways /= np.maximum(np.hypot(*ways.T), 1e-9)[:, None]
    owner = np.repeat(outside, [len(line) for line in lines])
    a, b = KDTree(points[:, :2]).query_pairs(LANE_WIDTH + _GAP + _STEP, output_type="ndarray").T
    a, b = np.concatenate([a, b]), np.concatenate([b, a])
    offset = points[b] - points[a]
    along = (offset[:, :2] * ways[a]).sum(1)
    apart = np.abs(offset[:, 0] * ways[a, 1] - offset[:, 1] * ways[a, 0])
    beside = (owner[a] != owner[b]) & (np.abs(along) <= _STEP) & (np.abs(offset[:, 2]) < MAX_STEP)
    beside &= (apart > _LEAST_APART) & (np.abs((ways[a] * ways[b]).sum(1)) > _PARALLEL)
    np.minimum.at(widths, owner[a[beside]], np.maximum(apart[beside] - _GAP, _LEAST_SHARE * LANE_WIDTH))
    return widths
