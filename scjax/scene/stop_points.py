"""Where vehicles stop at the signals of a log."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene.log import Log


class StopPoints(NamedTuple):
    """Stop points of the signals whose lane the map has.

    Attributes:
      signals: index of the signal of each stop point.
      positions: [m].
      directions: unit vectors along the lane there.
      ends: last point of the lane [m].
    """

    signals: Int[np.ndarray, " points"]
    positions: Float64[np.ndarray, "points 2"]
    directions: Float64[np.ndarray, "points 2"]
    ends: Float64[np.ndarray, "points 2"]

    def groups(self, distance: float) -> np.ndarray:
        """Which points share a place: nearer than ``distance`` [m], directions within 45 degrees [points, points]."""
        apart = np.linalg.norm(self.positions[:, None] - self.positions[None], axis=-1)
        return (apart < distance) & (self.directions @ self.directions.T > np.sqrt(0.5))


def stop_points(log: Log) -> StopPoints:
    """The recorded stop points; where a log does not know them, signals stop traffic at the start of their lane.

    Signals of absent lanes, and of lanes of no length, have none.
    """
    lanes = {lane.id: lane.points[:, :2] for lane in log.lanes if len(lane.points) > 1}
    signals, positions, directions, ends = [], [], [], []
    for row, (name, recorded) in enumerate(zip(log.signal_lane_ids, log.signal_positions, strict=True)):
        if name not in lanes:
            continue
        line = lanes[name]
        position = recorded[:2] if np.isfinite(recorded[:2]).all() else line[0]
        steps = np.diff(line, axis=0)
        moves = np.flatnonzero(np.hypot(*steps.T) > 1e-9)
        if not len(moves):
            continue
        near = moves[np.abs(moves - np.linalg.norm(line - position, axis=-1).argmin()).argmin()]
        signals.append(row)
        positions.append(position)
        directions.append(steps[near] / np.linalg.norm(steps[near]))
        ends.append(line[-1])
    arrays = (np.array(values, np.float64).reshape(-1, 2) for values in (positions, directions, ends))
    return StopPoints(np.array(signals, int), *arrays)
