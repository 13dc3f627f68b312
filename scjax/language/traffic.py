"""Agents relative to the ego: ahead, behind, in neighboring lanes, oncoming, crossing, parked."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from scjax.language.road import Road, wrap_to_pi
from scjax.language.turn_lanes import movement
from scjax.scene import AgentType, Scene

Motion = Literal["stopped", "slow", "moderate", "fast"]

_MOTION_LIMITS: tuple[tuple[float, Motion], ...] = (
    (0.5, "stopped"),
    (4.0, "slow"),
    (9.0, "moderate"),
    (np.inf, "fast"),
)  # m/s
_HALF_LANE = 1.75  # m from a centerline to the edge of its lane
_NEXT_LANE = 5.5  # m to the far edge of the neighboring lane
_SAME_DIRECTION = 0.6  # rad off the ego's path
_OPPOSITE_DIRECTION = 2.7  # rad off the ego's path
_ONCOMING_LATERAL = 20.0  # m to the side of the ego's path
_CROSSING_ANGLES = (1.0, 2.1)  # rad off the ego's heading
_ON_LANE_DISTANCE = 2.0  # m
_PARKED_SPEED, _PARKED_DISTANCE = 0.3, 1.6  # m/s at most, m from any lane at least
_OFF_ROAD_DISTANCE = 2.5  # m
_NEAR_ROAD_DISTANCE = 6.0  # m
_SIDE_DISTANCE = 4.0  # m to the side of the ego


@dataclasses.dataclass(frozen=True)
class Traffic:
    """Numbers of agents without the ego; a vehicle may count in several relations or in none.

    Attributes:
      vehicles, pedestrians, cyclists, static: agents of each type.
      ahead, behind: vehicles in the ego's lane.
      left_lane, right_lane: vehicles in the neighboring lane with the ego's direction.
      oncoming, crossing: vehicles on lanes, against and across the ego's heading.
      turning: vehicles on a lane that turns by more than 40 degrees.
      parked: stopped vehicles off the lanes.
      off_road: vehicles more than 2.5 m from any lane.
      pedestrians_left, pedestrians_right, pedestrians_near_road: pedestrians by position.
      ego_motion: speed of the ego in words; None where its speed is unknown.
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


def count_traffic(scene: Scene, road: Road, path: np.ndarray | None, *, has_ego: bool = True) -> Traffic:
    """Traffic of one scene without padding; agent 0 is the ego, ``path`` [n, 2] its path or None off the road.

    Args:
      has_ego: whether there is one; otherwise all agents count, and none in relation to an ego.
    """
    agents, types = np.asarray(scene.agents, np.float64), np.asarray(scene.agent_types)
    if not len(agents):
        return Traffic()
    motion: Motion | None = None
    if has_ego and bool(scene.agent_known[0, 3]):
        motion = next(name for limit, name in _MOTION_LIMITS if agents[0, 3] < limit)
    if has_ego:
        agents, types = agents[1:], types[1:]
    positions, heading, speed = agents[:, :2], np.arctan2(agents[:, 5], agents[:, 4]), agents[:, 3]
    vehicle, pedestrian = types == AgentType.VEHICLE, types == AgentType.PEDESTRIAN
    lane, distance = _nearest_lane(road, positions)
    on_lane = distance <= _ON_LANE_DISTANCE
    masks = {
        "vehicles": vehicle,
        "pedestrians": pedestrian,
        "cyclists": types == AgentType.CYCLIST,
        "static": types == AgentType.STATIC,
    }
    oncoming = np.zeros(len(agents), bool)
    if path is not None and len(path) > 2:
        along, left, angle = _relative_to_path(path, positions, heading)
        same_direction = vehicle & (np.abs(angle) < _SAME_DIRECTION)
        in_ego_lane = same_direction & (np.abs(left) < _HALF_LANE)
        oncoming = vehicle & on_lane & (np.abs(angle) > _OPPOSITE_DIRECTION) & (np.abs(left) < _ONCOMING_LATERAL)
        masks["ahead"], masks["behind"] = in_ego_lane & (along > 0), in_ego_lane & (along <= 0)
        masks["oncoming"] = oncoming
        masks["left_lane"] = same_direction & on_lane & (left >= _HALF_LANE) & (left < _NEXT_LANE)
        masks["right_lane"] = same_direction & on_lane & (left <= -_HALF_LANE) & (left > -_NEXT_LANE)
    across = (np.abs(heading) > _CROSSING_ANGLES[0]) & (np.abs(heading) < _CROSSING_ANGLES[1])
    masks["crossing"] = vehicle & on_lane & across & ~oncoming & has_ego
    on_turn = np.array([k >= 0 and movement(float(road.turn[k])) != "straight" for k in lane], bool)
    masks["turning"] = vehicle & on_lane & on_turn
    masks["parked"] = vehicle & (speed < _PARKED_SPEED) & (distance > _PARKED_DISTANCE)
    masks["off_road"] = vehicle & (distance > _OFF_ROAD_DISTANCE)
    masks["pedestrians_left"] = pedestrian & (positions[:, 1] > _SIDE_DISTANCE) & has_ego
    masks["pedestrians_right"] = pedestrian & (positions[:, 1] < -_SIDE_DISTANCE) & has_ego
    masks["pedestrians_near_road"] = pedestrian & (distance < _NEAR_ROAD_DISTANCE)
    return Traffic(ego_motion=motion, **{name: int(mask.sum()) for name, mask in masks.items()})


def _nearest_lane(road: Road, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest lane of each position [n], -1 without lanes, and the distance to its points [n] in m."""
    if not len(road) or not len(positions):
        return np.full(len(positions), -1), np.full(len(positions), np.inf)
    distance = np.linalg.norm(positions[:, None, None] - road.points[None], axis=-1).min(-1)
    return distance.argmin(1), distance.min(1)


def _relative_to_path(
    path: np.ndarray, positions: np.ndarray, heading: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offsets along the path from the ego and to its left [m], and headings relative to the path [rad]."""
    step = np.diff(path, axis=0)
    path_heading = np.arctan2(step[:, 1], step[:, 0])
    ego = int(np.linalg.norm(path, axis=-1).argmin())
    point = np.linalg.norm(positions[:, None] - path[None], axis=-1).argmin(1)
    direction = path_heading[np.minimum(point, len(path_heading) - 1)]
    offset = positions - path[point]
    cos, sin = np.cos(direction), np.sin(direction)
    along = (point - ego) + cos * offset[:, 0] + sin * offset[:, 1]
    return along, cos * offset[:, 1] - sin * offset[:, 0], wrap_to_pi(heading - direction)
