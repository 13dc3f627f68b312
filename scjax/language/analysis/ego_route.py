"""The ego's lane and its way along it, and where agents are relative to that way."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64

from scjax.language.analysis.agent_lanes import AgentLanes
from scjax.language.analysis.lane_lines import LaneLines
from scjax.language.analysis.routes import Route, straightest_route
from scjax.scene.angles import wrap_to_pi

_MAX_DISTANCE, _MAX_ANGLE = 2.5, np.deg2rad(50.0)  # m, rad between the ego and its lane
_ANGLE_COST = 2.0  # m per rad
_LENGTH_BONUS, _MAX_BONUS_LENGTH = 0.02, 15.0  # m per m: a long lane is the likelier one
REACH = 34.0  # m of the way, ahead and behind


@dataclasses.dataclass(frozen=True)
class EgoRoute:
    """The ego's lane and its way.

    Attributes:
      lane, point: index of the lane and of its point beside the ego.
      ahead, behind: the straightest ways from there on.
      points: both together in driving direction, x, y, z [m] and heading [rad].
      along: distance of every point from the ego, negative behind it [m].
    """

    lane: int
    point: int
    ahead: Route
    behind: Route
    points: Float64[np.ndarray, "points 4"]
    along: Float64[np.ndarray, " points"]

    def points_ahead(self, distance: float) -> Float64[np.ndarray, "points 4"]:
        """The points up to so far ahead of the ego [m]."""
        return self.points[(self.along >= 0) & (self.along <= distance)]

    def pose(self, along: float) -> np.ndarray:
        """x, y, z and heading at a distance from the ego."""
        return self.points[int(np.abs(self.along - along).argmin())]


@dataclasses.dataclass(frozen=True)
class RoutePositions:
    """Agents relative to the ego's way.

    Attributes:
      along: distance from the ego along the way [m].
      lateral: to its left [m].
      angle: absolute angle between the agent and the way [rad].
      beside: whether the way passes the agent, rather than ending before it.
    """

    along: Float64[np.ndarray, " agents"]
    lateral: Float64[np.ndarray, " agents"]
    angle: Float64[np.ndarray, " agents"]
    beside: np.ndarray


def find_ego_route(lines: LaneLines, relations: AgentLanes) -> EgoRoute | None:
    """The way of agent 0; None where it is on no lane."""
    if not len(lines) or not len(relations.distance):
        return None
    distance, angle = relations.distance[0], relations.angle[0]
    cost = distance + _ANGLE_COST * angle - _LENGTH_BONUS * np.minimum(lines.length, _MAX_BONUS_LENGTH)
    cost = np.where((distance < _MAX_DISTANCE) & (angle < _MAX_ANGLE), cost, np.inf)
    if not np.isfinite(cost.min()):
        return None
    lane = int(cost.argmin())
    point = int(relations.point[0, lane])
    ahead = straightest_route(lines, lane, point, REACH)
    behind = straightest_route(lines, lane, point, REACH, ahead=False)
    points = np.concatenate([behind.points[:0:-1], ahead.points])
    along = np.concatenate([-behind.distance[:0:-1], ahead.distance])
    return EgoRoute(lane, point, ahead, behind, points, along)


def route_positions(route: EgoRoute, agents: np.ndarray) -> RoutePositions:
    """Positions of agents [agents, 9] relative to a route."""
    offset = agents[:, None, :2] - route.points[None, :, :2]
    nearest = (offset**2).sum(-1).argmin(1)
    rows = np.arange(len(agents))
    heading = route.points[nearest, 3]
    offset = offset[rows, nearest]
    forward = np.cos(heading) * offset[:, 0] + np.sin(heading) * offset[:, 1]
    lateral = np.cos(heading) * offset[:, 1] - np.sin(heading) * offset[:, 0]
    inside = ((nearest > 0) | (forward > -1.0)) & ((nearest < len(route.points) - 1) | (forward < 1.0))
    yaw = np.arctan2(agents[:, 5], agents[:, 4])
    return RoutePositions(route.along[nearest] + forward, lateral, np.abs(wrap_to_pi(yaw - heading)), inside)
