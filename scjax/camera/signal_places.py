"""Where signals are: their stop lines, and heads above the way ahead, which maps do not hold."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import Log
from scjax.scene.stop_lines import stop_lines

HEAD_SIZE, HEAD_HEIGHT = (0.35, 0.35, 1.0), 5.0  # m; size of a head, and its middle above the ground
_HEAD_AHEAD = (12.0, 25.0)  # m from the stop line; within it, heads hang above the end of the lane


class SignalPlaces(NamedTuple):
    """Places of signals; z is that of the lane at the stop line, NaN where the map has none.

    Attributes:
      rows: index of the signal.
      lines: both ends of the stop line [m].
      heads: below the middle of the head, on the ground [m].
      headings: of the traffic that the signal stops [rad].
    """

    rows: Int[np.ndarray, " n"]
    lines: Float64[np.ndarray, "n 2 3"]
    heads: Float64[np.ndarray, "n 3"]
    headings: Float64[np.ndarray, " n"]


def signal_places(log: Log) -> SignalPlaces:
    """Stop lines as in pictures from above, and a head above the way ahead of each."""
    rows, flat = stop_lines(log)
    middles = flat.mean(1).reshape(-1, 2)
    across = flat[:, 1] - flat[:, 0]
    ahead = np.stack([-across[:, 1], across[:, 0]], -1)  # ends go from left to right
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    lanes = {lane.id: lane.points for lane in log.lanes}
    heights, distances = np.full(len(rows), np.nan), np.zeros(len(rows))
    for k, row in enumerate(rows.tolist()):
        points = lanes[log.signal_lane_ids[row]]
        heights[k] = points[np.linalg.norm(points[:, :2] - middles[k], axis=-1).argmin(), 2]
        distances[k] = (points[-1, :2] - middles[k]) @ ahead[k]
    heads = middles + distances.clip(*_HEAD_AHEAD)[:, None] * ahead
    lines = np.concatenate([flat, np.repeat(heights, 2).reshape(-1, 2, 1)], -1)
    places = np.concatenate([heads, heights[:, None]], -1)
    return SignalPlaces(rows, lines, places, np.arctan2(ahead[:, 1], ahead[:, 0]))
