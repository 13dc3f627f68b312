"""Agents of new tiles that come too near to others: on top of them, or so close that no braking helps; NumPy."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

from scjax.scene import AgentType
from scjax.scene.angles import wrap_to_pi
from scjax.scene.boxes import overlaps
from scjax.sim.agents import agent_columns
from scjax.sim.preparation import Start
from scjax.sim.road_network import NONE

_NEAR = 60.0  # m from new agents, within which others count
_BRAKING = 3.0  # m/s^2 that drivers accept
_SECONDS = np.arange(0.25, 2.6, 0.25)
_MARGIN = 0.4  # m by which boxes are longer and wider
_WAY = np.arange(1.0, 17.0)  # m of the way past parked bodies
_SIDE_GAP = 0.1  # m beside parked bodies that drivers keep
_RETURN_LENGTH = 12.0  # m over which vehicles return to the centerline


def arrivals_too_near(start: Start, new: set[str], gone: set[str]) -> set[str]:
    """Those of the new agents that overlap others, collide with them within 2.5 s, or keep them from moving.

    A collision counts if neither of both could brake. Vehicles that stand beside their centerline, close behind a
    parked body, could not set off. Of two new agents the later one is too near. Vehicles keep to their lane; other
    agents stay where they are.

    Args:
      new: ids of agents of ``start``.
      gone: ids of agents that do not count.
    """
    ids = start.log.object_ids
    arrives = np.array([name in new for name in ids], bool)
    counts = np.array([name not in gone for name in ids], bool)
    places = np.array(start.log.positions[:, 0, :2])
    if not (arrives & counts).any():
        return set()
    apart = np.hypot(*np.moveaxis(places[:, None] - places[None, arrives & counts], -1, 0)).min(1)
    rows = np.flatnonzero(counts & (apart < _NEAR))
    rows = np.concatenate([rows[~arrives[rows]], rows[arrives[rows]]])  # who was there before comes first
    meets, count = _meetings(start, rows), int((~arrives[rows]).sum())
    stays = np.ones(len(rows), bool)
    for row in range(count, len(rows)):
        stays[row] = not (meets[row, :row] & stays[:row]).any()
    return {ids[row] for row in rows[~stays]}


def _meetings(start: Start, rows: np.ndarray) -> Bool[np.ndarray, "n n"]:
    """Pairs of agents that overlap now, that collide whichever of them brakes, or of which one is parked in the way."""
    ways = _Ways(start, rows)
    now = ways.boxes(np.zeros(len(rows)))
    meets, speed, count = overlaps(now), now[:, 3], len(rows)
    fails = np.zeros((count, count), bool)  # i brakes, j drives on
    for seconds in _SECONDS:
        until = np.minimum(seconds, speed / _BRAKING)
        both = [ways.boxes(speed * until - _BRAKING * until**2 / 2), ways.boxes(speed * seconds)]
        moved = np.concatenate(both)
        moved[:, 6:8] += _MARGIN
        fails |= overlaps(moved)[:count, count:]
    meets |= fails & fails.T
    walks = np.asarray(start.agents.kind)[rows] == AgentType.PEDESTRIAN
    blocked = np.zeros((count, count), bool)  # i drives, j is parked
    for distance in _WAY:
        passing = ways.boxes(np.full(count, distance))
        passing[:, 7] += _SIDE_GAP
        blocked |= overlaps(passing)
    blocked &= ways.drives[:, None] & ~(ways.drives | walks)[None]
    meets |= blocked | blocked.T
    np.fill_diagonal(meets, False)
    return meets


class _Ways:
    """Where agents get on their lanes.

    Attributes:
      drives: which of them follow a lane.
    """

    def __init__(self, start: Start, rows: np.ndarray):
        places, lanes = start.places, start.lanes
        self._states = agent_columns(start.agents, rows)
        self._lane, self._along = np.asarray(places.lane)[rows], np.asarray(places.along, np.float64)[rows]
        self.drives = self._lane != NONE
        self._states[~self.drives, 3] = 0.0
        count = len(lanes.points)  # the network has points of padding, and lanes that swerve
        self._points = np.stack([start.network.x[:count], start.network.y[:count]], -1).astype(np.float64)
        self._spans = [slice(first, first + more + 1) for first, more in zip(lanes.first, lanes.intervals, strict=True)]
        self._lanes = lanes

    def boxes(self, distance: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 9"]:
        """Columns of ``Scene.agents`` after vehicles have driven ``distance`` [m]; they return to the centerline."""
        out = self._states.copy()
        for row in np.flatnonzero(self.drives).tolist():
            before, after = (self._pose(row, float(more)) for more in (0.0, distance[row]))
            turn, share = after[2] - before[2], np.exp(-distance[row] / _RETURN_LENGTH)
            x, y = share * (out[row, :2] - before[:2])
            angle = before[2] + turn + share * wrap_to_pi(np.arctan2(out[row, 5], out[row, 4]) - before[2])
            cos, sin = np.cos(turn), np.sin(turn)
            out[row, :2] = after[0] + cos * x - sin * y, after[1] + sin * x + cos * y
            out[row, 4:6] = np.cos(angle), np.sin(angle)
        return out

    def _pose(self, row: int, ahead: float) -> np.ndarray:
        """x, y [m] and heading [rad] of the lane of an agent ``ahead`` of it [m]; straight on beyond the end."""
        span, along = self._spans[int(self._lane[row])], float(self._along[row]) + ahead
        arc, headings = self._lanes.along[span], np.unwrap(self._lanes.headings[span])
        x, y = (np.interp(along, arc, column) for column in self._points[span].T)
        heading, beyond = np.interp(along, arc, headings), max(along - arc[-1], 0.0)
        return np.array([x + beyond * np.cos(heading), y + beyond * np.sin(heading), heading])
