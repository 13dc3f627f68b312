"""A finished network as arrays: what traffic needs to know of every lane at every step."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.synthetic.curves import arc_of
from scjax.synthetic.network import Network

STEP = 1.0  # metres between the stored points of a lane, at most
_WAY = 2.6  # metres between the centrelines of connectors that cannot be driven at once
_SHARES = {"through": 3.0, "left": 1.0, "right": 1.0, None: 1.0}  # of traffic, by turn


@dataclasses.dataclass(frozen=True)
class Tracks:
    """Lanes of a network in arrays [lanes] (all -1 where there is none).

    Attributes:
      points, start, count: equally spaced points of all lanes, where a lane's begin, how many it has.
      speed, rank, junction, entry: as in ``Lane``.
      successors: [lanes, most]; shares: cumulated shares of traffic among them.
      shared: the lane is entered from two lanes or more.
      conflict: connectors that cross or join, by lane.
      sources: lanes that traffic enters the map by.
    """

    points: Float64[np.ndarray, "points 2"]
    start: Int[np.ndarray, " lanes"]
    count: Int[np.ndarray, " lanes"]
    length: Float64[np.ndarray, " lanes"]
    speed: Float64[np.ndarray, " lanes"]
    rank: Int[np.ndarray, " lanes"]
    junction: Int[np.ndarray, " lanes"]
    entry: Int[np.ndarray, " lanes"]
    successors: Int[np.ndarray, "lanes most"]
    shares: Float64[np.ndarray, "lanes most"]
    shared: Bool[np.ndarray, " lanes"]
    conflict: Bool[np.ndarray, "lanes lanes"]
    sources: Int[np.ndarray, " sources"]

    def place(
        self, lane: Int[np.ndarray, " n"], at: Float64[np.ndarray, " n"]
    ) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
        """Points ``at`` metres along lanes, and the direction there [rad]."""
        share = np.clip(at / self.length[lane], 0, 1) * (self.count[lane] - 1)
        low = np.minimum(share.astype(int), self.count[lane] - 2)
        row = self.start[lane] + low
        first, last = self.points[row], self.points[row + 1]
        step = last - first
        return first + (share - low)[:, None] * step, np.arctan2(step[:, 1], step[:, 0])

    def after(self, lane: Int[np.ndarray, " n"], draw: Float64[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """A successor of each lane, picked by numbers drawn from 0 .. 1."""
        choice = (draw[:, None] > self.shares[lane]).sum(-1)
        return self.successors[lane, np.minimum(choice, self.successors.shape[1] - 1)]


def track(net: Network) -> Tracks:
    """Arrays of ``net``."""
    count = len(net.lanes)
    lines = []
    for lane in net.lanes:
        arc = arc_of(lane.points)
        at = np.linspace(0, arc[-1], max(3, int(np.ceil(arc[-1] / STEP)) + 1))
        lines.append((np.stack([np.interp(at, arc, lane.points[:, d]) for d in (0, 1)], -1), arc[-1]))
    counts = np.array([len(points) for points, _ in lines])
    most = max(1, max(len(lane.successors) for lane in net.lanes))
    successors, shares = np.full((count, most), -1), np.ones((count, most))
    entered = np.zeros(count, int)
    for k, lane in enumerate(net.lanes):
        after = lane.successors
        if not after:
            continue
        successors[k, : len(after)] = after
        weights = np.cumsum([_SHARES[net.lanes[j].turn] for j in after])
        shares[k, : len(after)] = weights / weights[-1]
        entered[after] += 1
    return Tracks(
        points=np.concatenate([points for points, _ in lines]),
        start=np.cumsum(counts) - counts,
        count=counts,
        length=np.array([length for _, length in lines]),
        speed=np.array([lane.speed for lane in net.lanes]),
        rank=np.array([lane.rank for lane in net.lanes]),
        junction=np.array([lane.junction for lane in net.lanes]),
        entry=np.array([lane.entry for lane in net.lanes]),
        successors=successors,
        shares=shares,
        shared=entered > 1,
        conflict=_conflicts(net, lines),
        sources=np.array([k for k, lane in enumerate(net.lanes) if not entered[k] and not lane.centre], int),
    )


def _conflicts(net: Network, lines: list) -> np.ndarray:
    """Connectors of one junction that come close to each other; those from one lane only part."""
    conflict = np.zeros((len(net.lanes),) * 2, bool)
    for number in range(len(net.junctions)):
        rows = [k for k, lane in enumerate(net.lanes) if lane.junction == number]
        if len(rows) < 2:
            continue
        parts = [lines[k][0][::2] for k in rows]
        owner = np.repeat(np.arange(len(rows)), [len(part) for part in parts])
        points = np.concatenate(parts)
        gap = points[:, None] - points[None]
        near = (gap[..., 0] ** 2 + gap[..., 1] ** 2) < _WAY**2
        found = np.zeros((len(rows), len(rows)), bool)
        a, b = np.nonzero(near)
        found[owner[a], owner[b]] = True
        entry = np.array([net.lanes[k].entry for k in rows])
        found &= ~((entry[:, None] == entry[None]) & (entry[:, None] >= 0))
        np.fill_diagonal(found, False)
        conflict[np.ix_(rows, rows)] = found
    return conflict
