"""Emergency corridor: two lanes of slow traffic that make way for an emergency vehicle between them."""

from __future__ import annotations

import numpy as np

from scjax.language.events.base import ALIGNED, AgentLaneRelations, EventRule

_MIN_LATERAL = 0.35  # m, mean offset of a lane's vehicles towards its outer edge
_MAX_LATERAL = 1.5  # m, vehicles further off drive in another lane
_MAX_SPEED = 3.5  # m/s
_MIN_VEHICLES = 2  # per lane
_LANE_SPACING = (-7.5, -3.0)  # m, lateral position of the right lane relative to the left lane


def _detect(relations: AgentLaneRelations) -> bool:
    """Whether the vehicles of two neighboring lanes keep to the outer edges."""
    queued = relations.is_vehicle & (relations.speeds < _MAX_SPEED)
    queued &= (np.abs(relations.angle) < ALIGNED) & (np.abs(relations.lateral) < _MAX_LATERAL)
    vehicles = {int(lane): queued & (relations.lane == lane) for lane in np.unique(relations.lane[queued])}
    return any(
        _is_corridor(relations, left, right)
        for left_lane, left in vehicles.items()
        for right_lane, right in vehicles.items()
        if left_lane != right_lane
    )


def _is_corridor(relations: AgentLaneRelations, left: np.ndarray, right: np.ndarray) -> bool:
    """Whether vehicles ``left`` and ``right`` (masks of two lanes) form a corridor, in this order."""
    if left.sum() < _MIN_VEHICLES or right.sum() < _MIN_VEHICLES:
        return False
    if not (np.mean(relations.lateral[left]) > _MIN_LATERAL and np.mean(relations.lateral[right]) < -_MIN_LATERAL):
        return False
    heading = relations.headings[left][0]
    offset = relations.positions[right] - relations.positions[left][0]
    lateral = np.cos(heading) * offset[:, 1] - np.sin(heading) * offset[:, 0]
    return bool(_LANE_SPACING[0] < np.median(lateral) < _LANE_SPACING[1])


EMERGENCY_CORRIDOR = EventRule(
    "emergency corridor",
    ("an emergency corridor", "vehicles making way for an emergency vehicle"),
    r"emergency (?:corridor|lane)|making way for an emergency",
    _detect,
)
