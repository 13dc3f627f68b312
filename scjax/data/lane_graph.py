"""From recorded map lanes to the lane graph: joins, compaction of degree-2 chains, neighbours, signals (float64)."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64, Int
from scipy.spatial import KDTree

from scjax.data import neighbors as neighbours
from scjax.data.ragged import arc_lengths
from scjax.data.readers.scene_json import RawLane, RawScene
from scjax.scene.lane_chains import compact

DROPPED_SUBTYPES = ("bike_lane", "undefined")  # cars do not drive on them
JOIN_DISTANCE = 0.05  # metres between an end and a start that are one point where topology is not given
DUPLICATE = 1e-6  # metres


@dataclasses.dataclass(frozen=True)
class LaneGraph:
    """Compacted lanes of a scene, in the source's frame or any other (all rules are rigid-motion invariant).

    Attributes:
      points, offsets: ragged centrelines in driving direction [m], z NaN where unknown.
      edges: (i, j), lane j follows lane i.
      beside: (i, j), lane i is the left neighbour of lane j and runs the same way.
      spans: for each such pair, from and to on lane i, from and to on lane j, in xy arc length [m].
      signals: ``Signal`` of each lane at each step.
    """

    points: Float64[np.ndarray, "points 3"]
    offsets: Int[np.ndarray, " offsets"]
    edges: Int[np.ndarray, "edges 2"]
    beside: Int[np.ndarray, "pairs 2"]
    spans: Float64[np.ndarray, "pairs 4"]
    signals: Int[np.ndarray, "lanes steps"]

    @property
    def num_lanes(self) -> int:
        return len(self.offsets) - 1


def build_graph(raw: RawScene) -> LaneGraph:
    """The compacted lane graph of a recorded scene (eval rule, steps 1-3; numbers in ``DROPPED_SUBTYPES`` etc.).

    Raises:
      ValueError: if no lane with two distinct points is left.
    """
    lanes = [(lane, _distinct(lane.points)) for lane in raw.lanes if lane.subtype not in DROPPED_SUBTYPES]
    lanes = [(lane, points) for lane, points in lanes if len(points) >= 2]
    if not lanes:
        raise ValueError(f"{raw.path}: no lane with two distinct points that cars may use: leave this file out")
    joins = _given_joins([lane for lane, _ in lanes]) if raw.topology_given else _near_joins([p for _, p in lanes])
    chains, edges = compact(len(lanes), joins)
    points = [np.concatenate([lanes[chain[0]][1], *(lanes[member][1][1:] for member in chain[1:])]) for chain in chains]
    offsets = np.concatenate([[0], np.cumsum([len(p) for p in points])])
    stacked = np.concatenate(points)
    unknown = np.add.reduceat(np.isnan(stacked[:, 2]), offsets[:-1]) > 0
    stacked[np.repeat(unknown, np.diff(offsets)), 2] = np.nan
    if raw.topology_given:
        beside, spans = neighbours.recorded([lane for lane, _ in lanes], chains, stacked, offsets)
    else:
        beside, spans = neighbours.by_geometry(stacked, offsets)
    state = dict(zip(raw.signal_lanes, raw.signals, strict=True))
    signals = np.zeros((len(chains), raw.num_steps), np.int8)
    for row, chain in enumerate(chains):
        member = next((i for i in chain if lanes[i][0].id in state), None)
        if member is not None:
            signals[row] = state[lanes[member][0].id]
    return LaneGraph(stacked, offsets, edges, beside, spans, signals)


def _distinct(points: np.ndarray) -> np.ndarray:
    step = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return points[np.concatenate([[True], step >= DUPLICATE])[: len(points)]]


def _given_joins(lanes: list[RawLane]) -> set[tuple[int, int]]:
    index = {lane.id: i for i, lane in enumerate(lanes)}
    joins = {(i, index[j]) for i, lane in enumerate(lanes) for j in lane.successors if j in index}
    return joins | {(index[j], i) for i, lane in enumerate(lanes) for j in lane.predecessors if j in index}


def _near_joins(points: list[np.ndarray]) -> set[tuple[int, int]]:
    first, last = np.stack([p[0, :2] for p in points]), np.stack([p[-1, :2] for p in points])
    close = KDTree(last).query_ball_tree(KDTree(first), JOIN_DISTANCE)
    return {(i, j) for i, found in enumerate(close) for j in found}


@dataclasses.dataclass(frozen=True)
class SegmentIndex:
    """All segments of a graph, findable by place; segments longer than 2 m are held in parts."""

    tree: KDTree
    start: Float64[np.ndarray, "segments 2"]
    end: Float64[np.ndarray, "segments 2"]
    lane: Int[np.ndarray, " segments"]
    z: Float64[np.ndarray, "segments 2"]
    half: float  # half the length of the longest segment


def index_segments(graph: LaneGraph, longest: float = 2.0) -> SegmentIndex:
    """Search structure for ``nearest_lane``."""
    inner = np.ones(len(graph.points) - 1, bool)
    inner[graph.offsets[1:-1] - 1] = False
    first = np.flatnonzero(inner)
    start, end = graph.points[first], graph.points[first + 1]
    parts = np.maximum(np.ceil(np.hypot(*(end - start)[:, :2].T) / longest).astype(int), 1)
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
    """Exact distance [m] to the nearest centreline, its heading [rad] and z [m] there, each [queries]."""
    if not len(xy):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    total = len(index.lane)
    reach, rows = index.tree.query(xy, min(candidates, total))
    reach, rows = reach.reshape(len(xy), -1), np.sort(rows.reshape(len(xy), -1), axis=1)
    distance, ratio = _segment_distance(index, xy, rows)
    best = distance.argmin(1)
    rest = np.arange(len(xy))
    row, near, ratio = rows[rest, best], distance[rest, best], ratio[rest, best]
    # A segment whose midpoint is farther than all candidates' may still be nearer by half its length.
    unsure = np.flatnonzero(near > reach[:, -1] - index.half) if total > candidates else []
    for query in unsure:
        d, t = _segment_distance(index, xy[query : query + 1], np.arange(total)[None])
        row[query] = d[0].argmin()
        near[query], ratio[query] = d[0, row[query]], t[0, row[query]]
    direction = index.end[row] - index.start[row]
    z = index.z[row, 0] + ratio * (index.z[row, 1] - index.z[row, 0])
    return near, np.arctan2(direction[:, 1], direction[:, 0]), z


def _segment_distance(index: SegmentIndex, xy: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    start, delta = index.start[rows], index.end[rows] - index.start[rows]
    to = xy[:, None] - start
    ratio = np.clip((to * delta).sum(-1) / (delta * delta).sum(-1), 0.0, 1.0)
    gap = to - ratio[..., None] * delta
    return np.sqrt((gap * gap).sum(-1)), ratio


def lane_lengths(graph: LaneGraph) -> Float64[np.ndarray, " lanes"]:
    """xy length of every lane in metres."""
    return arc_lengths(graph.points, graph.offsets)[graph.offsets[1:] - 1]
