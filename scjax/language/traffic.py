"""Who is where, as seen by the ego: ahead, behind, beside, oncoming, crossing, parked."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from scjax.language.road import Road, wrapped
from scjax.language.turn_lanes import movement
from scjax.scene import AgentType, Scene

Motion = Literal["stopped", "slow", "moderate", "fast"]

_SPEEDS: tuple[tuple[float, Motion], ...] = (
    (0.5, "stopped"),
    (4.0, "slow"),
    (9.0, "moderate"),
    (np.inf, "fast"),
)  # m/s
_LANE = 1.75  # metres from the middle of a lane to its edge
_NEXT = 5.5  # metres to the far edge of the next lane
_ALONG = 0.6  # rad off the path
_AGAINST, _AGAINST_REACH = 2.7, 20.0  # rad off the path, metres to its side
_ACROSS = (1.0, 2.1)  # rad off the ego
_ON_LANE = 2.0  # metres
_PARKED = (0.3, 1.6)  # m/s at most, metres off any lane at least
_OFF_ROAD = 2.5  # metres
_BY_THE_ROAD = 6.0  # metres
_ASIDE = 4.0  # metres


@dataclasses.dataclass(frozen=True)
class Traffic:
    """Numbers of agents, the ego left out; a vehicle may count in several relations or in none.

    Attributes:
      ahead, behind: in the ego's lane. left_lane, right_lane: in the next lane, driving the ego's way.
      oncoming, crossing, turning: on lanes; turning: on one that turns by more than 40 degrees.
      parked: standing beside the lanes. off_road: more than 2.5 m from any lane.
      pedestrians_left, pedestrians_right, pedestrians_near_road: of the pedestrians.
    """

    vehicles: int = 0
    pedestrians: int = 0
    cyclists: int = 0
    static: int = 0
    ahead: int = 0
    behind: int = 0
    left_lane: int = 0
    right_lane: int = 0
    oncoming: int = 0
    crossing: int = 0
    turning: int = 0
    parked: int = 0
    off_road: int = 0
    pedestrians_left: int = 0
    pedestrians_right: int = 0
    pedestrians_near_road: int = 0
    ego_motion: Motion | None = None


def traffic_of(scene: Scene, road: Road, path: np.ndarray | None) -> Traffic:
    """Traffic of one scene without padding, whose agent 0 is the ego."""
    agents, types = np.asarray(scene.agents, np.float64), np.asarray(scene.agent_types)
    if not len(agents):
        return Traffic()
    speed_known = bool(scene.agent_known[0, 3])
    motion: Motion | None = None
    if speed_known:
        motion = next(name for limit, name in _SPEEDS if agents[0, 3] < limit)
    agents, types = agents[1:], types[1:]
    kinds = {kind: types == kind for kind in AgentType}
    lane, distance = _nearest_lane(road, agents[:, :2])
    heading, speed, vehicle = np.arctan2(agents[:, 5], agents[:, 4]), agents[:, 3], kinds[AgentType.VEHICLE]
    on_lane = distance <= _ON_LANE
    counts: dict[str, np.ndarray] = {}
    against = np.zeros(len(agents), bool)
    if path is not None and len(path) > 2:
        along, left, off = _by_path(path, agents[:, :2], heading)
        with_it = vehicle & (np.abs(off) < _ALONG)
        in_lane = with_it & (np.abs(left) < _LANE)
        against = vehicle & on_lane & (np.abs(off) > _AGAINST) & (np.abs(left) < _AGAINST_REACH)
        counts |= {"ahead": in_lane & (along > 0), "behind": in_lane & (along <= 0), "oncoming": against}
        counts |= {"left_lane": with_it & on_lane & (left >= _LANE) & (left < _NEXT)}
        counts |= {"right_lane": with_it & on_lane & (left <= -_LANE) & (left > -_NEXT)}
    across = (np.abs(heading) > _ACROSS[0]) & (np.abs(heading) < _ACROSS[1])
    counts["crossing"] = vehicle & on_lane & across & ~against
    turns = np.array([k >= 0 and movement(float(road.turn[k])) != "straight" for k in lane], bool)
    counts["turning"] = vehicle & on_lane & turns
    counts["parked"] = vehicle & (speed < _PARKED[0]) & (distance > _PARKED[1])
    counts["off_road"] = vehicle & (distance > _OFF_ROAD)
    walking = kinds[AgentType.PEDESTRIAN]
    counts["pedestrians_left"] = walking & (agents[:, 1] > _ASIDE)
    counts["pedestrians_right"] = walking & (agents[:, 1] < -_ASIDE)
    counts["pedestrians_near_road"] = walking & (distance < _BY_THE_ROAD)
    counts |= {"vehicles": vehicle, "pedestrians": walking, "cyclists": kinds[AgentType.CYCLIST]}
    counts["static"] = kinds[AgentType.STATIC]
    return Traffic(ego_motion=motion, **{name: int(flags.sum()) for name, flags in counts.items()})


def _nearest_lane(road: Road, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest lane of each place, -1 without any, and the distance to its points [m]."""
    if not len(road) or not len(places):
        return np.full(len(places), -1), np.full(len(places), np.inf)
    distance = np.linalg.norm(places[:, None, None] - road.line[None], axis=-1).min(-1)
    return distance.argmin(1), distance.min(1)


def _by_path(path: np.ndarray, places: np.ndarray, heading: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Along the path from the ego, to its left [m], and heading off the path [rad]."""
    step = np.diff(path, axis=0)
    direction = np.arctan2(step[:, 1], step[:, 0])
    here = int(np.linalg.norm(path, axis=-1).argmin())
    near = np.linalg.norm(places[:, None] - path[None], axis=-1).argmin(1)
    at = np.minimum(near, len(direction) - 1)
    apart = places - path[near]
    cos, sin = np.cos(direction[at]), np.sin(direction[at])
    along = (near - here) + cos * apart[:, 0] + sin * apart[:, 1]
    return along, cos * apart[:, 1] - sin * apart[:, 0], wrapped(heading - direction[at])
