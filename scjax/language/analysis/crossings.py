"""Where lanes cross each other, at one height or above each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.language.analysis.lane_lines import LaneLines
from scjax.scene.angles import wrap_to_pi

MAX_LEVEL = 2.5  # m of height between lanes of one level
_MIN_CLEARANCE = 3.3  # m of height between lanes that pass over each other
_MIN_ANGLE = np.deg2rad(22.0)
_END_DISTANCE = 0.6  # m, lanes that begin or end together do not cross there


class Crossings(NamedTuple):
    """Points where two lanes cross.

    Attributes:
      lanes: the two lanes.
      points: place, with the mean height [m].
      clearance: height between them [m].
    """

    lanes: Int[np.ndarray, "crossings 2"]
    points: Float64[np.ndarray, "crossings 3"]
    clearance: Float64[np.ndarray, " crossings"]

    def at_level(self) -> Crossings:
        """Those at one height."""
        return self._where(self.clearance <= MAX_LEVEL)

    def over(self) -> Crossings:
        """Those of lanes that pass over each other."""
        return self._where(self.clearance > _MIN_CLEARANCE)

    def _where(self, rows: np.ndarray) -> Crossings:
        return Crossings(self.lanes[rows], self.points[rows], self.clearance[rows])


def find_crossings(lines: LaneLines) -> Crossings:
    """All crossings at 22 degrees or more of lanes that do not follow each other."""
    low, high = lines.raw[..., :2].min(1), lines.raw[..., :2].max(1)
    near = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(-1)
    near &= ~(lines.follows | lines.follows.T)
    first, second = np.nonzero(np.triu(near, 1))
    p, q = lines.raw[first][:, :-1, None], lines.raw[second][:, None, :-1]
    r, s = np.diff(lines.raw[first], axis=1)[:, :, None], np.diff(lines.raw[second], axis=1)[:, None]
    offset = q - p
    area = r[..., 0] * s[..., 1] - r[..., 1] * s[..., 0]
    scale = np.where(np.abs(area) > 1e-9, area, np.inf)
    t = (offset[..., 0] * s[..., 1] - offset[..., 1] * s[..., 0]) / scale
    u = (offset[..., 0] * r[..., 1] - offset[..., 1] * r[..., 0]) / scale
    hits = np.nonzero((t >= 0) & (t <= 1) & (u >= 0) & (u <= 1) & np.isfinite(scale))
    pair, a, b = hits
    first, second = first[pair], second[pair]
    above = lines.raw[first, a] + t[hits][:, None] * r[pair, a, 0]
    below = lines.raw[second, b] + u[hits][:, None] * s[pair, 0, b]
    turn = np.arctan2(s[pair, 0, b, 1], s[pair, 0, b, 0]) - np.arctan2(r[pair, a, 0, 1], r[pair, a, 0, 0])
    angle = np.abs(wrap_to_pi(turn))
    keep = np.minimum(angle, np.pi - angle) >= _MIN_ANGLE
    keep &= ~(_at_end(lines, first, above) & _at_end(lines, second, below))
    rows = np.flatnonzero(keep)
    return Crossings(
        np.stack([first, second], -1)[rows],
        (above + below)[rows] / 2,
        np.abs(above[:, 2] - below[:, 2])[rows],
    )


def _at_end(lines: LaneLines, lane: np.ndarray, place: np.ndarray) -> np.ndarray:
    ends = lines.raw[lane][:, [0, -1], :2] - place[:, None, :2]
    return np.any((np.hypot(ends[..., 0], ends[..., 1]) < _END_DISTANCE), axis=-1)
