"""The road network of a map: equally spaced points, speeds, neighbors, conflicts, borders; NumPy on the host."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int

from scjax.data.lane_graph import LaneGraph, build_graph
from scjax.scene import TILE_SIZE, Log
from scjax.scene.angles import wrap_to_pi
from scjax.scene.map import MapTile
from scjax.scene.polyline import cumulative_length
from scjax.sim.lane_conflicts import LaneConflicts, find_conflicts, rank_lanes
from scjax.sim.road_network import MAX_CONFLICTS, MAX_SUCCESSORS, NONE, POINT_SPACING, RoadNetwork

SPEEDS = {"freeway": 29.0, "surface_street": 14.0}  # m/s
_DEFAULT_SPEED, _MIN_SPEED = 14.0, 2.5  # m/s
_LATERAL_ACCELERATION = 2.2  # m/s^2 in a bend
_CURVATURE_SPAN = 3  # points on either side
_BORDER = 4.0  # m from the edge of a tile, where roads lead out of the map


@dataclasses.dataclass(frozen=True)
class LanePoints:
    """P points of L lanes, one lane after the other, equally spaced within a lane.

    Attributes:
      points: in the frame of the network [m].
      origin: of that frame in the frame of the map [m].
      headings: direction of travel [rad].
      lane: index of the lane of each point.
      along: xy arc length from the start of the lane [m].
      first, intervals: row of the first point of each lane, and its number of points less one.
      length: of each lane in xy [m].
    """

    points: Float64[np.ndarray, "P 3"]
    origin: Float64[np.ndarray, 3]
    headings: Float64[np.ndarray, " P"]
    lane: Int[np.ndarray, " P"]
    along: Float64[np.ndarray, " P"]
    first: Int[np.ndarray, " L"]
    intervals: Int[np.ndarray, " L"]
    length: Float64[np.ndarray, " L"]


def lane_graph_of(log: Log) -> LaneGraph:
    """The lane graph that roll-outs use: merged lanes begin where a signal stands."""
    return build_graph(log, split_at_signals=True, signals_alone=True)


def space_points(graph: LaneGraph, origin: Float64[np.ndarray, 3]) -> LanePoints:
    """Points of every lane at most ``POINT_SPACING`` apart; unknown z becomes that of ``origin``."""
    lines, alongs, headings = [], [], []
    for row in range(graph.num_lanes):
        line = graph.points[graph.offsets[row] : graph.offsets[row + 1]] - origin
        arc = cumulative_length(line)
        at = np.linspace(0.0, arc[-1], max(int(np.ceil(arc[-1] / POINT_SPACING)), 1) + 1)
        spaced = np.stack([np.interp(at, arc, np.nan_to_num(line[:, d])) for d in range(3)], -1)
        step = np.gradient(spaced[:, :2], axis=0)
        lines.append(spaced)
        alongs.append(at)
        headings.append(np.arctan2(step[:, 1], step[:, 0]))
    counts = np.array([len(line) for line in lines])
    return LanePoints(
        points=np.concatenate(lines),
        origin=origin,
        headings=np.concatenate(headings),
        lane=np.repeat(np.arange(len(lines)), counts),
        along=np.concatenate(alongs),
        first=np.cumsum(counts) - counts,
        intervals=counts - 1,
        length=np.array([along[-1] for along in alongs]),
    )


def build_road_network(
    log: Log, graph: LaneGraph, lanes: LanePoints, signal_rows: dict[str, int], tiles: Sequence[MapTile] = ()
) -> RoadNetwork:
    """The network without padding, as NumPy arrays.

    Args:
      log: whose lanes they are; types of lanes give speeds.
      graph: of ``lane_graph_of``.
      lanes: of ``space_points``.
      signal_rows: row of the signal of each lane id.
      tiles: of the map. Vehicles leave and enter where lanes end at their outer edges; without tiles at every end.
    """
    turn = _turns(lanes)
    conflicts = find_conflicts(lanes.points[:, :2], lanes.headings, lanes.lane, lanes.along, graph.successors)
    table, kept = _conflict_table(conflicts, graph.num_lanes)
    following = np.full((graph.num_lanes, MAX_SUCCESSORS), NONE, np.int32)
    for lane in range(graph.num_lanes):
        after = graph.successors[graph.successors[:, 0] == lane, 1][:MAX_SUCCESSORS]
        following[lane, : len(after)] = after
    has_successor = following[:, 0] >= 0
    has_predecessor = np.isin(np.arange(graph.num_lanes), graph.successors[:, 1])
    last = lanes.first + lanes.intervals
    is_exit = ~has_successor & _at_border(lanes.points[last, :2] + lanes.origin[:2], tiles)
    is_entry = ~has_predecessor & _at_border(lanes.points[lanes.first, :2] + lanes.origin[:2], tiles)
    left, left_span, right, right_span = _neighbors(graph)
    kind = {lane.id: lane.lane_type for lane in log.lanes}
    speeds = np.array([max(SPEEDS.get(kind[i] or "", _DEFAULT_SPEED) for i in ids) for ids in graph.lane_ids])
    return RoadNetwork(
        x=_single(lanes.points[:, 0]),
        y=_single(lanes.points[:, 1]),
        z=_single(lanes.points[:, 2]),
        heading=_single(lanes.headings),
        lane=lanes.lane.astype(np.int32),
        limit=_single(_limits(lanes, speeds)),
        first=lanes.first.astype(np.int32),
        intervals=lanes.intervals.astype(np.int32),
        spacing=_single(lanes.length / lanes.intervals),
        length=_single(lanes.length),
        successors=following,
        turn=_single(turn),
        signal=np.array([signal_rows.get(ids[0], NONE) for ids in graph.lane_ids], np.int32),
        left=left,
        right=right,
        left_span=left_span,
        right_span=right_span,
        is_exit=is_exit,
        is_entry=is_entry,
        conflicts=table,
        conflict_start=_single(conflicts.start[kept]),
        conflict_end=_single(conflicts.end[kept]),
        conflict_other=np.searchsorted(kept, conflicts.other[kept]).astype(np.int32),
        conflict_merges=conflicts.merges[kept],
        conflict_rank=rank_lanes(turn, lanes.length, graph.successors)[conflicts.lane[kept]].astype(np.int32),
    )


def _single(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, np.float32)


def _turns(lanes: LanePoints) -> np.ndarray:
    """Change of heading of every lane [rad]."""
    change = wrap_to_pi(np.diff(lanes.headings))
    change[lanes.first[1:] - 1] = 0.0
    total = np.concatenate([[0.0], np.cumsum(change)])
    return total[lanes.first + lanes.intervals] - total[lanes.first]


def _limits(lanes: LanePoints, speeds: np.ndarray) -> np.ndarray:
    """Speed at every point [m/s]: that of the lane, or less in bends."""
    span = np.minimum(_CURVATURE_SPAN, lanes.intervals)[lanes.lane]
    low = np.maximum(np.arange(len(lanes.lane)) - span, lanes.first[lanes.lane])
    high = np.minimum(np.arange(len(lanes.lane)) + span, (lanes.first + lanes.intervals)[lanes.lane])
    change = wrap_to_pi(lanes.headings[high] - lanes.headings[low])
    curvature = np.abs(change) / np.maximum(lanes.along[high] - lanes.along[low], 1.0)
    bend = np.sqrt(_LATERAL_ACCELERATION / np.maximum(curvature, 1e-4))
    return np.maximum(np.minimum(speeds[lanes.lane], bend), _MIN_SPEED)


def _conflict_table(conflicts: LaneConflicts, num_lanes: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the conflicts of each lane [L, MAX_CONFLICTS], and the conflicts that are kept: the first on a lane."""
    order = np.lexsort([conflicts.start, conflicts.lane])
    rank = np.arange(len(order)) - np.searchsorted(conflicts.lane[order], conflicts.lane[order])
    fits = np.zeros(len(order), bool)
    fits[order] = rank < MAX_CONFLICTS
    fits &= fits[conflicts.other] if len(order) else fits
    kept = np.flatnonzero(fits)
    table = np.full((num_lanes, MAX_CONFLICTS), NONE, np.int32)
    used = np.zeros(num_lanes, int)
    for row, lane in enumerate(conflicts.lane[kept]):
        table[lane, used[lane]] = row
        used[lane] += 1
    return table, kept


def _neighbors(graph: LaneGraph) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The neighbor of each lane on the left and where it is one, then on the right; the longest overlap wins."""
    left, right = (np.full(graph.num_lanes, NONE, np.int32) for _ in range(2))
    left_span, right_span = (np.zeros((graph.num_lanes, 4), np.float32) for _ in range(2))
    for (i, j), span in zip(graph.neighbors, graph.overlap_spans, strict=True):
        if span[3] - span[2] > left_span[j, 1] - left_span[j, 0]:
            left[j], left_span[j] = i, span[[2, 3, 0, 1]]
        if span[1] - span[0] > right_span[i, 1] - right_span[i, 0]:
            right[i], right_span[i] = j, span
    return left, left_span, right, right_span


def _at_border(places: np.ndarray, tiles: Sequence[MapTile]) -> np.ndarray:
    """Whether places are at an outer edge of the tiles [places]; everywhere without tiles."""
    if not tiles:
        return np.ones(len(places), bool)
    inside = np.zeros(len(places), bool)
    for tile in tiles:
        cos, sin = np.cos(tile.yaw), np.sin(tile.yaw)
        local = (places - [tile.x, tile.y]) @ np.array([[cos, -sin], [sin, cos]])
        inside |= np.abs(local).max(-1) < TILE_SIZE / 2 - _BORDER
    return ~inside
