"""Cut-in: a moving vehicle that changes into a lane closely ahead of another vehicle."""

from __future__ import annotations

import numpy as np

from scjax.language.events.base import AgentLaneRelations, EventRule
from scjax.language.road import wrap_to_pi

_MIN_ANGLE, _MAX_ANGLE = 0.04, 0.3  # rad towards the target lane
_MAX_LATERAL = 2.6  # m from the centerline of the nearest lane
_MIN_SPEED = 2.0  # m/s
_TARGET_DISTANCE = (0.4, 2.2)  # m to the centerline of the target lane
_TARGET_ANGLE = 0.2  # rad between the target lane and the nearest lane
_MAX_ALONG = 2.0  # m along the lane between the vehicle and the nearest point of the target lane
_FOLLOWER_GAP = (0.5, 14.0)  # m behind the vehicle
_FOLLOWER_LATERAL = 1.1  # m from the centerline of the target lane
_FOLLOWER_SPEED = 1.5  # m/s
_FOLLOWER_COSINE = 0.9  # of the angle between the follower and the lane


def _detect(relations: AgentLaneRelations) -> bool:
    leaning = (np.abs(relations.angle) > _MIN_ANGLE) & (np.abs(relations.angle) < _MAX_ANGLE)
    candidates = relations.is_vehicle & (relations.speeds > _MIN_SPEED) & leaning
    candidates &= (np.abs(relations.lateral) < _MAX_LATERAL) & relations.is_eligible
    return any(_cuts_in(relations, int(k)) for k in np.flatnonzero(candidates))


def _cuts_in(relations: AgentLaneRelations, k: int) -> bool:
    """Whether vehicle ``k`` approaches the centerline of a lane with a follower close behind."""
    road = relations.road
    heading, side = relations.headings[k] - relations.angle[k], np.sign(relations.angle[k])
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    # The target lane is the nearest one in the direction of the change; it may already be the vehicle's own lane.
    lateral = (road.points - relations.positions[k]) @ left * side
    along = np.abs((road.points - relations.positions[k]) @ ahead)
    point, lanes = along.argmin(1), np.arange(len(road))
    lane_heading = road.headings[lanes, np.minimum(point, road.headings.shape[1] - 1)]
    distance = lateral[lanes, point]
    is_target = (np.abs(wrap_to_pi(lane_heading - heading)) < _TARGET_ANGLE) & (along[lanes, point] < _MAX_ALONG)
    is_target &= (distance > _TARGET_DISTANCE[0]) & (distance < _TARGET_DISTANCE[1])
    if not is_target.any():
        return False
    others = relations.all_agents
    offset = others[:, :2] - relations.positions[k]
    gap = -(offset @ ahead) - (others[:, 6] + relations.lengths[k]) / 2
    in_target_lane = np.abs((offset @ left) * side - distance[is_target].min()) < _FOLLOWER_LATERAL
    aligned = np.cos(np.arctan2(others[:, 5], others[:, 4]) - heading) > _FOLLOWER_COSINE
    follows = relations.all_vehicles & aligned & (others[:, 3] > _FOLLOWER_SPEED) & in_target_lane
    return bool((follows & (gap > _FOLLOWER_GAP[0]) & (gap < _FOLLOWER_GAP[1])).any())


CUT_IN = EventRule(
    "cut-in",
    ("a vehicle cutting in", "a vehicle that cuts into the next lane"),
    r"cut(?:s|ting)?[- ]in|cut-in",
    _detect,
)
