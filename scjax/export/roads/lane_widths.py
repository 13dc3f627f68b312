"""Widths of lanes: logs have none, so lanes are as wide as usual, or narrower where another one lies beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.export.roads.crossings import MAX_STEP
from scjax.export.roads.lane_borders import LaneBorders, at_fewer_stations, single_lane_borders
from scjax.export.roads.lane_curves import curve_line
from scjax.export.roads.wide_road import LaneEnd, WideRoad, lane_ends
from scjax.export.traffic import LANE_WIDTH

_LEAST_SHARE = 0.7  # of the usual width
_GAP = 0.1  # m between the borders of two roads
_STEP = 1.0  # m along a road
_LEAST_APART = 1.5  # m; nearer lanes lie on each other
_PARALLEL = 0.9  # cosine of the angle between lanes that lie beside each other


def all_lane_borders(roads: Sequence[WideRoad]) -> dict[int, LaneBorders]:
    """The borders of the lanes of all roads, by their ids.

    A road of one lane has one width. That of a way through a junction changes evenly between those at its ends.
    """
    borders = {road.id: at_fewer_stations(road.borders) for road in roads if road.borders is not None}
    rows = {road.id: {lane.number: row for row, lane in enumerate(road.lanes)} for road in roads}
    widths, ends_of = _single_widths(roads), lane_ends(roads)

    def width(end: LaneEnd) -> float:
        if end.road in widths:
            return widths[end.road]
        row = rows[end.road][end.number]
        left, right = borders[end.road].offsets[-1 if end.at_end else 0, row : row + 2].tolist()
        return left - right

    for road in roads:
        way = road.lanes[0].road
        if road.junction:
            ends = (width(ends_of[way.before].last), width(ends_of[way.after].first))
            borders[road.id] = single_lane_borders(road.curve, ends)
        elif road.id in widths:
            borders[road.id] = single_lane_borders(road.curve, (widths[road.id], widths[road.id]))
    return borders


def _single_widths(roads: Sequence[WideRoad]) -> dict[int, float]:
    """Widths of roads of one lane outside of junctions, by their ids [m]; those that follow each other have one."""
    widths = _free_widths(roads)
    is_stable = False
    while not is_stable:
        is_stable = True
        for road in roads:
            if road.id in widths and road.after in widths:
                least = min(widths[road.id], widths[road.after])
                is_stable &= widths[road.id] == widths[road.after]
                widths[road.id] = widths[road.after] = least
    return widths


def _free_widths(roads: Sequence[WideRoad]) -> dict[int, float]:
    """The usual width times the least share that the lanes of other roads leave, for each road of one lane."""
    from scipy.spatial import KDTree

    outside = [road for road in roads if not road.junction]
    lines = [(row, curve_line(lane.curve, _STEP)[0]) for row, road in enumerate(outside) for lane in road.lanes]
    if not lines:
        return {}
    steps = [np.gradient(line[:, :2], axis=0) for _, line in lines]
    points, ways = np.concatenate([line for _, line in lines]), np.concatenate(steps)
    ways /= np.maximum(np.hypot(*ways.T), 1e-9)[:, None]
    owner = np.repeat([row for row, _ in lines], [len(line) for _, line in lines])
    a, b = KDTree(points[:, :2]).query_pairs(LANE_WIDTH + _GAP + _STEP, output_type="ndarray").T
    a, b = np.concatenate([a, b]), np.concatenate([b, a])
    offset = points[b] - points[a]
    along = (offset[:, :2] * ways[a]).sum(1)
    apart = np.abs(offset[:, 0] * ways[a, 1] - offset[:, 1] * ways[a, 0])
    beside = (owner[a] != owner[b]) & (np.abs(along) <= _STEP) & (np.abs(offset[:, 2]) < MAX_STEP)
    beside &= (apart > _LEAST_APART) & (np.abs((ways[a] * ways[b]).sum(1)) > _PARALLEL)
    widths = np.full(len(outside), LANE_WIDTH)
    np.minimum.at(widths, owner[a[beside]], np.maximum(apart[beside] - _GAP, _LEAST_SHARE * LANE_WIDTH))
    return {road.id: float(widths[row]) for row, road in enumerate(outside) if len(road.lanes) == 1}
