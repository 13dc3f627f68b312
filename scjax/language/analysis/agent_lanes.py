"""Agents relative to every lane."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64, Int

from scjax.language.analysis.lane_lines import LaneLines
from scjax.scene.angles import wrap_to_pi

_MAX_HEIGHT = 3.5  # m between a lane and an agent on it
ON_LANE = 1.8  # m between a vehicle and the middle of its lane
_ALONG = np.deg2rad(50.0)  # between a vehicle and its lane


@dataclasses.dataclass(frozen=True)
class AgentLanes:
    """Relations of all agents to all lanes.

    Attributes:
      distance: to the line of the lane [m]; infinite for a lane at another height.
      point: index of the lane's nearest point.
      angle: absolute angle to the lane there [rad].
      lateral: to the left of the lane's nearest point [m].
      lane: the lane that an agent follows, within 1.8 m and 50 degrees; -1: none.
      offset: from the nearest lane of any direction [m]; infinite without lanes.
    """

    distance: Float64[np.ndarray, "agents lanes"]
    point: Int[np.ndarray, "agents lanes"]
    angle: Float64[np.ndarray, "agents lanes"]
    lateral: Float64[np.ndarray, "agents lanes"]
    lane: Int[np.ndarray, " agents"]
    offset: Float64[np.ndarray, " agents"]


def relate_to_lanes(lines: LaneLines, agents: Float64[np.ndarray, "agents 9"]) -> AgentLanes:
    """Relations for agents as in ``Scene.agents``."""
    shape = (len(agents), len(lines))
    if not all(shape):
        blank = np.zeros(shape)
        none = np.full(len(agents), -1)
        return AgentLanes(blank, blank.astype(int), blank, blank, none, np.full(len(agents), np.inf))
    delta_x = agents[:, None, None, 0] - lines.points[None, ..., 0]
    delta_y = agents[:, None, None, 1] - lines.points[None, ..., 1]
    point = (delta_x**2 + delta_y**2).argmin(-1)
    rows, lanes = np.arange(shape[0])[:, None], np.arange(shape[1])[None]
    heading = lines.headings[lanes, point]
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = delta_x[rows, lanes, point], delta_y[rows, lanes, point]
    forward, lateral = cos * x + sin * y, cos * y - sin * x
    beyond = ((point == 0) & (forward < 0)) | ((point == lines.count - 1) & (forward > 0))
    distance = np.where(beyond, np.hypot(x, y), np.abs(lateral))
    height = lines.points[lanes, point, 2]
    bottom = agents[:, 2] - agents[:, 8] / 2
    apart = np.minimum(np.abs(height - bottom[:, None]), np.abs(height - agents[:, None, 2])) > _MAX_HEIGHT
    distance = np.where(apart, np.inf, distance)
    yaw = np.arctan2(agents[:, 5], agents[:, 4])
    angle = np.abs(wrap_to_pi(heading - yaw[:, None]))
    cost = np.where((distance < ON_LANE) & (angle < _ALONG), distance + angle, np.inf)
    lane = np.where(np.isfinite(cost.min(1)), cost.argmin(1), -1)
    return AgentLanes(distance, point, angle, lateral, lane, distance.min(1))
