"""Where a map shows its signals: a line across each lane that a signal controls."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import Log

_WIDTH = 3.2  # m
_TOGETHER = 1.5  # m; signals whose stop points are nearer share one line


class StopLines(NamedTuple):
    """Lines in the order in which they are drawn.

    Attributes:
      rows: index of the signal of each line.
      ends: both ends of each line [m].
    """

    rows: Int[np.ndarray, " lines"]
    ends: Float64[np.ndarray, "lines 2 2"]


def stop_lines(log: Log) -> StopLines:
    """A line for each signal of a lane of the map, across its stop point, or across the start of the lane without one.

    Lanes that part at one place have signals there that may differ: each gets its share of the line, and they lie side
    by side as the lanes end.
    """
    lanes = {lane.id: lane.points[:, :2] for lane in log.lanes if len(lane.points) > 1}
    rows, points, aheads, targets = [], [], [], []
    for row, (name, recorded) in enumerate(zip(log.signal_lane_ids, log.signal_positions, strict=True)):
        line = lanes.get(name)
        if line is None:
            continue
        point = recorded[:2] if np.isfinite(recorded[:2]).all() else line[0]
        near = min(int(np.linalg.norm(line - point, axis=-1).argmin()), len(line) - 2)
        along = line[near + 1] - line[near]
        rows.append(row)
        points.append(point)
        aheads.append(along / max(float(np.linalg.norm(along)), 1e-9))
        targets.append(line[-1])
    if not rows:
        return StopLines(np.zeros(0, int), np.zeros((0, 2, 2)))
    places, ahead = np.array(points), np.array(aheads)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], -1)
    ends = np.zeros((len(rows), 2, 2))
    group = _groups(places, ahead)
    for leader in np.unique(group):
        members = np.flatnonzero(group == leader)
        aside = (np.array(targets)[members] - places[leader]) @ left[leader]
        members = members[np.argsort(-aside, kind="stable")]  # from left to right
        cuts = _WIDTH * (0.5 - np.arange(len(members) + 1) / len(members))
        for k, member in enumerate(members):
            ends[member] = places[leader] + cuts[k : k + 2, None] * left[leader]
    return StopLines(np.array(rows), ends)


def _groups(places: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """For each signal the first one at the same place with the same direction."""
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    return ((apart < _TOGETHER) & (ahead @ ahead.T > 0.7)).argmax(1)
