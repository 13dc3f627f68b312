"""A complete network as arrays, for the traffic simulation."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene.polyline import cumulative_length
from scjax.synthetic.network import Network

_POINT_SPACING = 1.0  # m at most, between the points of a lane
CONFLICT_DISTANCE = 2.6  # m between the centerlines of connectors that exclude each other
LONG_VEHICLE = 9.0  # m
_LONG_WEIGHTS = {"through": 50.0, "left": 1.0, "right": 1.0, None: 1.0}  # of long vehicles
_TURN_WEIGHTS = {"through": 3.0, "left": 1.0, "right": 1.0, None: 1.0}  # of traffic


@dataclasses.dataclass(frozen=True)
class LaneArrays:
    """Lanes of a network in arrays [lanes]; indices are -1 where there is none.

    Attributes:
      points: equally spaced points of all lanes, one lane after the other [m].
      start, count: first row in ``points`` and number of points.
      length: [m].
      speed, rank, junction, entry_lane: as in ``Lane``.
      successors: lanes that follow.
      successor_shares: cumulative shares of traffic among the successors.
      long_shares: those of long vehicles, which go straight on where they can.
      predecessor: the first lane before.
      left, right: neighboring lanes with the same direction.
      is_merge: the lane has two predecessors or more.
      conflicts: pairs of connectors that cross or merge.
      entries: lanes where traffic enters the map.
    """

    points: Float64[np.ndarray, "points 2"]
    start: Int[np.ndarray, " lanes"]
    count: Int[np.ndarray, " lanes"]
    length: Float64[np.ndarray, " lanes"]
    speed: Float64[np.ndarray, " lanes"]
    rank: Int[np.ndarray, " lanes"]
    junction: Int[np.ndarray, " lanes"]
    entry_lane: Int[np.ndarray, " lanes"]
    successors: Int[np.ndarray, "lanes most"]
    successor_shares: Float64[np.ndarray, "lanes most"]
    long_shares: Float64[np.ndarray, "lanes most"]
    predecessor: Int[np.ndarray, " lanes"]
    left: Int[np.ndarray, " lanes"]
    right: Int[np.ndarray, " lanes"]
    is_merge: Bool[np.ndarray, " lanes"]
    conflicts: Bool[np.ndarray, "lanes lanes"]
    entries: Int[np.ndarray, " entries"]

    def poses_at(
        self, lane: Int[np.ndarray, " n"], along: Float64[np.ndarray, " n"]
    ) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
        """Positions [m] and headings [rad] at arc lengths ``along`` [m] of lanes."""
        fraction = np.clip(along / self.length[lane], 0, 1) * (self.count[lane] - 1)
        segment = np.minimum(fraction.astype(int), self.count[lane] - 2)
        row = self.start[lane] + segment
        first, last = self.points[row], self.points[row + 1]
        step = last - first
        return first + (fraction - segment)[:, None] * step, np.arctan2(step[:, 1], step[:, 0])

    def pick_successors(
        self, lane: Int[np.ndarray, " n"], uniform: Float64[np.ndarray, " n"], length: Float64[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
        """One successor per lane, chosen by uniform random numbers in 0..1, for vehicles of some ``length`` [m]."""
        is_long = (length > LONG_VEHICLE)[:, None]
        choice = (uniform[:, None] > np.where(is_long, self.long_shares[lane], self.successor_shares[lane])).sum(-1)
        return self.successors[lane, np.minimum(choice, self.successors.shape[1] - 1)]


def build_lane_arrays(net: Network) -> LaneArrays:
    """Arrays of ``net``."""
    count = len(net.lanes)
    lines, lengths = [], []
    for lane in net.lanes:
        arc = cumulative_length(lane.points)
        positions = np.linspace(0, arc[-1], max(3, int(np.ceil(arc[-1] / _POINT_SPACING)) + 1))
        lines.append(np.stack([np.interp(positions, arc, lane.points[:, d]) for d in (0, 1)], -1))
        lengths.append(arc[-1])
    counts = np.array([len(points) for points in lines])
    most = max(1, max(len(lane.successors) for lane in net.lanes))
    successors, predecessor = np.full((count, most), -1), np.full(count, -1)
    shares, long_shares = np.ones((count, most)), np.ones((count, most))
    num_predecessors = np.zeros(count, int)
    for k, lane in enumerate(net.lanes):
        if not lane.successors:
            continue
        successors[k, : len(lane.successors)] = lane.successors
        for table, turn_weights in ((shares, _TURN_WEIGHTS), (long_shares, _LONG_WEIGHTS)):
            weights = np.cumsum([turn_weights[net.lanes[j].turn] for j in lane.successors])
            table[k, : len(lane.successors)] = weights / weights[-1]
        num_predecessors[lane.successors] += 1
        predecessor[[j for j in lane.successors if predecessor[j] < 0]] = k
    return LaneArrays(
        points=np.concatenate(lines),
        start=np.cumsum(counts) - counts,
        count=counts,
        length=np.array(lengths),
        speed=np.array([lane.speed for lane in net.lanes]),
        rank=np.array([lane.rank for lane in net.lanes]),
        junction=np.array([lane.junction for lane in net.lanes]),
        entry_lane=np.array([lane.entry_lane for lane in net.lanes]),
        successors=successors,
        successor_shares=shares,
        long_shares=long_shares,
        predecessor=predecessor,
        left=np.array([-1 if lane.left is None else lane.left for lane in net.lanes]),
        right=np.array([-1 if lane.right is None else lane.right for lane in net.lanes]),
        is_merge=num_predecessors > 1,
        conflicts=_find_conflicts(net, lines),
        entries=np.flatnonzero(num_predecessors == 0),
    )


def _find_conflicts(net: Network, lines: list[np.ndarray]) -> np.ndarray:
    """Pairs of connectors of one junction that come close to each other [lanes, lanes], except from the same lane."""
    conflicts = np.zeros((len(net.lanes),) * 2, bool)
    for number in range(len(net.junctions)):
        rows = [k for k, lane in enumerate(net.lanes) if lane.junction == number]
        if len(rows) < 2:
            continue
        parts = [lines[k][::2] for k in rows]
        connector = np.repeat(np.arange(len(rows)), [len(part) for part in parts])
        points = np.concatenate(parts)
        offset = points[:, None] - points[None]
        i, j = np.nonzero((offset[..., 0] ** 2 + offset[..., 1] ** 2) < CONFLICT_DISTANCE**2)
        is_close = np.zeros((len(rows), len(rows)), bool)
        is_close[connector[i], connector[j]] = True
        entry = np.array([net.lanes[k].entry_lane for k in rows])
        is_close &= ~((entry[:, None] == entry[None]) & (entry[:, None] >= 0))
        np.fill_diagonal(is_close, False)
        conflicts[np.ix_(rows, rows)] = is_close
    return conflicts
