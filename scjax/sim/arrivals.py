"""Agents of new tiles that come too near to others: on top of them, or so close that no braking helps; NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64

from scjax.scene import AgentType
from scjax.scene.angles import wrap_to_pi
from scjax.scene.boxes import overlaps
from scjax.sim.preparation import Start
from scjax.sim.road_network import NONE

_NEAR = 60.0  # m from new agents, within which others count
_BRAKING = 3.0  # m/s^2 that drivers accept
_SECONDS = np.arange(0.25, 2.6, 0.25)
_MARGIN = 0.4  # m by which boxes are longer and wider


def arrivals_too_near(start: Start, new: set[str]) -> set[str]:
    """Those of the new agents that overlap others, or that collide with them within 2.5 s even if one of both brakes.

    Of two new agents the later one is too near. Vehicles keep to their lane; other agents stay where they are.

    Args:
      new: ids of agents of ``start``.
    """
    ids = start.log.object_ids
    arrives = np.array([name in new for name in ids], bool)
    places = np.array(start.log.positions[:, 0, :2])
    if not arrives.any():
        return set()
    apart = np.hypot(*np.moveaxis(places[:, None] - places[None, arrives], -1, 0)).min(1)
    rows = np.flatnonzero(apart < _NEAR)
    rows = np.concatenate([rows[~arrives[rows]], rows[arrives[rows]]])  # who was there before comes first
    meets, count = _meetings(start, rows), int((~arrives[rows]).sum())
    stays = np.ones(len(rows), bool)
    for row in range(count, len(rows)):
        stays[row] = not (meets[row, :row] & stays[:row]).any()
    return {ids[row] for row in rows[~stays]}


def _meetings(start: Start, rows: np.ndarray) -> Bool[np.ndarray, "n n"]:
    """Pairs of agents that overlap now, or collide whichever of them brakes while the other drives on."""
    now = _boxes(start, rows, np.zeros(len(rows)))
    meets = overlaps(now)
    now[:, 6:8] += _MARGIN
    speed, count = now[:, 3], len(rows)
    fails = np.zeros((count, count), bool)  # i brakes, j drives on
    for seconds in _SECONDS:
        until = np.minimum(seconds, speed / _BRAKING)
        both = [_boxes(start, rows, speed * until - _BRAKING * until**2 / 2), _boxes(start, rows, speed * seconds)]
        moved = np.concatenate(both)
        moved[:, 6:8] += _MARGIN
        fails |= overlaps(moved)[:count, count:]
    np.fill_diagonal(fails, False)
    return meets | (fails & fails.T)


def _boxes(start: Start, rows: np.ndarray, distance: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 9"]:
    """Columns of ``Scene.agents`` after vehicles have driven ``distance`` along their lanes [m]."""
    agents, places = start.agents, start.places
    columns = [agents.x, agents.y, agents.z, agents.speed, np.cos(agents.heading), np.sin(agents.heading)]
    columns += [agents.length, agents.width, agents.height]
    out = np.stack([np.asarray(column, np.float64)[rows] for column in columns], -1)
    drives = (np.asarray(places.lane)[rows] != NONE) & ~np.asarray(places.is_parked)[rows]
    drives &= np.asarray(agents.kind)[rows] != AgentType.PEDESTRIAN
    out[~drives, 3] = 0.0
    for k in np.flatnonzero(drives):
        lane, along = int(places.lane[rows[k]]), float(places.along[rows[k]])
        before, after = _LaneView.of(start, lane).at(along), _LaneView.of(start, lane).at(along + distance[k])
        angle = float(agents.heading[rows[k]]) + wrap_to_pi(after[2] - before[2])
        out[k, :2] += after[:2] - before[:2]
        out[k, 4:6] = np.cos(angle), np.sin(angle)
    return out


@dataclasses.dataclass(frozen=True)
class _LaneView:
    """One lane of the start: points [m], headings [rad] and arc length [m]."""

    points: Float64[np.ndarray, "points 2"]
    headings: Float64[np.ndarray, " points"]
    along: Float64[np.ndarray, " points"]

    @classmethod
    def of(cls, start: Start, lane: int) -> _LaneView:
        lanes = start.lanes
        rows = slice(lanes.first[lane], lanes.first[lane] + lanes.intervals[lane] + 1)
        return cls(lanes.points[rows, :2], np.unwrap(lanes.headings[rows]), lanes.along[rows])

    def at(self, distance: float) -> np.ndarray:
        """x, y, heading; straight on beyond the end."""
        x, y = (np.interp(distance, self.along, column) for column in self.points.T)
        heading, beyond = np.interp(distance, self.along, self.headings), max(distance - self.along[-1], 0.0)
        return np.array([x + beyond * np.cos(heading), y + beyond * np.sin(heading), heading])
