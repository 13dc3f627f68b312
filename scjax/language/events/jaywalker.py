"""Jaywalker: a pedestrian who crosses a lane away from junctions."""

from __future__ import annotations

import numpy as np

from scjax.language.events.base import AgentLaneRelations, EventRule

_MAX_LATERAL = 1.6  # m from the centerline
_MIN_ANGLE = np.deg2rad(40.0)  # between the walking direction and the lane, either way
_MIN_SPEED = 0.5  # m/s


def _detect(relations: AgentLaneRelations) -> bool:
    angle = np.minimum(np.abs(relations.angle), np.pi - np.abs(relations.angle))
    crossing = (np.abs(relations.lateral) < _MAX_LATERAL) & (angle > _MIN_ANGLE) & (relations.speeds > _MIN_SPEED)
    return bool((relations.is_pedestrian & crossing & relations.is_eligible).any())


JAYWALKER = EventRule(
    "jaywalker",
    ("a jaywalker crossing the road", "a pedestrian crossing the road away from any crosswalk"),
    r"jaywalk|away from any crosswalk",
    _detect,
)
