"""The map of a log -> the lane graph: joins, merged chains, neighbors and signals (float64)."""

from __future__ import annotations

import dataclasses
import itertools
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64, Int

from scjax.data.join_options import JoinOptions
from scjax.data.lane_joins import inferred_joins, recorded_joins
from scjax.data.neighbors import infer_neighbors, recorded_neighbors
from scjax.data.ragged import arc_lengths
from scjax.scene import Log
from scjax.scene.lane_chains import merge_degree2_chains
from scjax.scene.map_lane import NO_CAR_LANE_TYPES

if TYPE_CHECKING:
    from scipy.spatial import KDTree

BEND_TURN, BEND_RADIUS = float(np.deg2rad(45.0)), 20.0  # rad and m, of sharp bends
MAX_BEND_LENGTH, MAX_BEND_RATIO = 55.0, 5.0  # m of a merged lane with a sharp bend; of its length to the radius
DUPLICATE_DISTANCE = 1e-6  # m between two points that are one


@dataclasses.dataclass(frozen=True)
class LaneGraph:
    """The lanes of a log with degree-2 chains merged, in the log's frame or any other.

    All rules that make it are invariant under rigid motion.

    Attributes:
      points, offsets: centerlines as ragged polylines in driving direction [m]; z is NaN where unknown.
      successors: (i, j), lane j follows lane i.
      neighbors: (i, j), lane i is the left neighbor of lane j and runs the same way.
      overlap_spans: for each neighbor pair: start and end on lane i, start and end on lane j, in xy arc length [m].
      signals: ``Signal`` of each lane at each step.
      warnings, notes: what to report of the source's connections and neighbors -> how often (``Joins``).
      lane_ids: for each lane, the ids of the lanes of the log that were merged into it, in driving direction.
    """

    points: Float64[np.ndarray, "points 3"]
    offsets: Int[np.ndarray, " offsets"]
    successors: Int[np.ndarray, "edges 2"]
    neighbors: Int[np.ndarray, "pairs 2"]
    overlap_spans: Float64[np.ndarray, "pairs 4"]
    signals: Int[np.ndarray, "lanes steps"]
    warnings: dict[str, int] = dataclasses.field(default_factory=dict)
    notes: dict[str, int] = dataclasses.field(default_factory=dict)
    lane_ids: tuple[tuple[str, ...], ...] = ()

    @property
    def num_lanes(self) -> int:
        """Number of merged lanes."""
        return len(self.offsets) - 1

    @property
    def lane_lengths(self) -> Float64[np.ndarray, " lanes"]:
        """Length of every lane in xy [m]."""
        return arc_lengths(self.points, self.offsets)[self.offsets[1:] - 1]


def build_graph(
    log: Log,
    join_options: JoinOptions | None = None,
    *,
    split_at_signals: bool = False,
    signals_alone: bool = False,
    bends_alone: bool = False,
) -> LaneGraph:
    """The lane graph of a log (evaluation rule, steps 1-3).

    Args:
      join_options: of sources without topology; by default those of the evaluation rule.
      split_at_signals: end merged lanes behind each signal, so that none is lost or reaches beyond its junction. The
        evaluation rule merges them all and keeps the first signal.
      signals_alone: end merged lanes also where a signal begins, so that no lane before a junction shows its signal.
      bends_alone: a sharp bend does not become part of a long lane, since few points could not show it. The evaluation
        rule merges both.

    Raises:
      ValueError: if no lane with two distinct points is left.
    """
    lanes, points = [], []
    for lane in log.lanes:
        distinct = distinct_points(lane.points)
        if lane.lane_type not in NO_CAR_LANE_TYPES and len(distinct) >= 2:
            lanes.append(lane)
            points.append(distinct)
    if not lanes:
        source = log.metadata.source_file or log.metadata.scene_id
        raise ValueError(f"{source}: no lane with two distinct points that cars may use: leave this log out")
    if log.has_topology:
        joins = recorded_joins(lanes, points)
    else:
        joins = inferred_joins(points, join_options or JoinOptions())
    warnings = dict(joins.warnings)
    breaks = _signal_ends(log, [lane.id for lane in lanes], joins.pairs) if split_at_signals else frozenset()
    if signals_alone:
        with_signal = set(log.signal_lane_ids)
        signaled = [lane.id in with_signal for lane in lanes]
        breaks |= {(i, j) for i, j in joins.pairs if signaled[j] and not signaled[i]}
    if bends_alone:
        breaks |= _bend_ends(points, joins.pairs, breaks)
    chains, successors = merge_degree2_chains(len(lanes), joins.pairs, breaks)
    merged = [np.concatenate([points[chain[0]], *(points[member][1:] for member in chain[1:])]) for chain in chains]
    offsets = np.concatenate([[0], np.cumsum([len(line) for line in merged])])
    stacked = np.concatenate(merged)
    unknown = np.add.reduceat(np.isnan(stacked[:, 2]), offsets[:-1]) > 0
    stacked[np.repeat(unknown, np.diff(offsets)), 2] = np.nan
    if log.has_topology:
        neighbors, overlap_spans, refused = recorded_neighbors(lanes, chains, stacked, offsets)
        if refused:
            warnings["listed lane neighbors refused, more than 8 m apart"] = refused
    else:
        neighbors, overlap_spans = infer_neighbors(stacked, offsets)
    ids = tuple(tuple(lanes[member].id for member in chain) for chain in chains)
    signals = _chain_signals(log, ids)
    return LaneGraph(stacked, offsets, successors, neighbors, overlap_spans, signals, warnings, joins.notes, ids)


def _total_turn(line: np.ndarray) -> float:
    """Sum of the changes of direction along a line [rad]."""
    headings = np.unwrap(np.arctan2(*np.diff(line[:, :2], axis=0).T[::-1]))
    return float(np.abs(np.diff(headings)).sum())


def _bend_ends(
    points: list[np.ndarray], joins: set[tuple[int, int]], breaks: frozenset[tuple[int, int]]
) -> frozenset[tuple[int, int]]:
    """Pairs of lanes that follow each other, of which one is a sharp bend in a chain too long to show it."""
    steps = [np.diff(line[:, :2], axis=0) for line in points]
    lengths = [float(np.hypot(*step.T).sum()) for step in steps]
    turns = [_total_turn(line) for line in points]
    max_length = [
        min(MAX_BEND_LENGTH, MAX_BEND_RATIO * length / turn)
        if turn > BEND_TURN and turn > length / BEND_RADIUS
        else np.inf
        for turn, length in zip(turns, lengths, strict=True)
    ]
    ends: set[tuple[int, int]] = set()
    for chain in merge_degree2_chains(len(points), joins, breaks)[0]:
        total = sum(lengths[k] for k in chain)
        ends |= {(i, j) for i, j in itertools.pairwise(chain) if total > min(max_length[i], max_length[j])}
    return frozenset(ends)


def _signal_ends(log: Log, ids: list[str], joins: set[tuple[int, int]]) -> frozenset[tuple[int, int]]:
    """Pairs of lanes that follow each other, of which the first has a signal that the second does not have."""
    states = {lane_id: row.tobytes() for lane_id, row in zip(log.signal_lane_ids, log.signal_states, strict=True)}
    return frozenset((i, j) for i, j in joins if ids[i] in states and states[ids[i]] != states.get(ids[j]))


def _chain_signals(log: Log, chains: tuple[tuple[str, ...], ...]) -> Int[np.ndarray, "chains steps"]:
    """Signal states of merged lanes: those of the first member that has a signal."""
    states = dict(zip(log.signal_lane_ids, log.signal_states, strict=True))
    signals = np.zeros((len(chains), log.num_steps), np.int8)
    for row, chain in enumerate(chains):
        member = next((lane_id for lane_id in chain if lane_id in states), None)
        if member is not None:
            signals[row] = states[member]
    return signals


def distinct_points(points: np.ndarray) -> np.ndarray:
    """``points`` without those that repeat the one before."""
    step = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return points[np.concatenate([[True], step >= DUPLICATE_DISTANCE])[: len(points)]]


@dataclasses.dataclass(frozen=True)
class SegmentIndex:
    """All segments of a lane graph in a search tree; long segments are split into parts.

    Attributes:
      tree: midpoints of the segments.
      start, end: xy [m]; z at both [m].
      lane: index of the segment's lane.
      half: half the length of the longest segment [m].
    """

    tree: KDTree
    start: Float64[np.ndarray, "segments 2"]
    end: Float64[np.ndarray, "segments 2"]
    lane: Int[np.ndarray, " segments"]
    z: Float64[np.ndarray, "segments 2"]
    half: float


def index_segments(graph: LaneGraph, max_length: float = 2.0) -> SegmentIndex:
    """Search structure for ``nearest_lane``; segments are split into parts of at most ``max_length`` [m]."""
    from scipy.spatial import KDTree

    inner = np.ones(len(graph.points) - 1, bool)
    inner[graph.offsets[1:-1] - 1] = False
    first = np.flatnonzero(inner)
    start, end = graph.points[first], graph.points[first + 1]
    parts = np.maximum(np.ceil(np.hypot(*(end - start)[:, :2].T) / max_length).astype(int), 1)
    row = np.repeat(np.arange(len(first)), parts)
    part = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    low, high = (part / parts[row])[:, None], ((part + 1) / parts[row])[:, None]
    delta = (end - start)[row]
    head = start[row] + low * delta
    tail = np.where(high == 1, end[row], start[row] + high * delta)
    lane = np.searchsorted(graph.offsets, first[row], side="right") - 1
    half = float(np.hypot(*(tail - head)[:, :2].T).max() / 2)
    z = np.stack([head[:, 2], tail[:, 2]], -1)
    return SegmentIndex(KDTree((head + tail)[:, :2] / 2), head[:, :2], tail[:, :2], lane, z, half)


def nearest_lane(
    index: SegmentIndex, xy: Float64[np.ndarray, "queries 2"], candidates: int = 32
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact distance [m] to the nearest centerline, its heading [rad] and z [m] there, each [queries].

    Args:
      candidates: segments tried per query before the exact fallback.
    """
    if not len(xy):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    total = len(index.lane)
    to_midpoint, rows = index.tree.query(xy, min(candidates, total))
    to_midpoint, rows = to_midpoint.reshape(len(xy), -1), np.sort(rows.reshape(len(xy), -1), axis=1)
    distance, ratio = _segment_distance(index, xy, rows)
    best = distance.argmin(1)
    query = np.arange(len(xy))
    row, nearest, ratio = rows[query, best], distance[query, best], ratio[query, best]
    # A segment whose midpoint is farther than all candidates' may still be nearer by half its length.
    uncertain = np.flatnonzero(nearest > to_midpoint[:, -1] - index.half) if total > candidates else []
    for k in uncertain:
        distances, ratios = _segment_distance(index, xy[k : k + 1], np.arange(total)[None])
        row[k] = distances[0].argmin()
        nearest[k], ratio[k] = distances[0, row[k]], ratios[0, row[k]]
    direction = index.end[row] - index.start[row]
    z = index.z[row, 0] + ratio * (index.z[row, 1] - index.z[row, 0])
    return nearest, np.arctan2(direction[:, 1], direction[:, 0]), z


def _segment_distance(index: SegmentIndex, xy: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] to each segment in ``rows`` [queries, k], and the nearest point as a share of the segment."""
    start, delta = index.start[rows], index.end[rows] - index.start[rows]
    offset = xy[:, None] - start
    ratio = np.clip((offset * delta).sum(-1) / (delta * delta).sum(-1), 0.0, 1.0)
    gap = offset - ratio[..., None] * delta
    return np.sqrt((gap * gap).sum(-1)), ratio
