"""Wrong-way driver: a vehicle that moves against its lane."""

from __future__ import annotations

import numpy as np

from scjax.language.events.base import AgentLaneRelations, EventRule

_MAX_DISTANCE = 1.3  # m from the centerline of the opposite lane
_MIN_ANGLE = np.deg2rad(150.0)  # to the opposite lane
_ALLOWED_ANGLE = np.deg2rad(60.0)  # to a lane that the vehicle may drive in
_ALLOWED_DISTANCE = 2.6  # m, within which such a lane explains the vehicle
_MIN_SPEED = 1.0  # m/s


def _detect(relations: AgentLaneRelations) -> bool:
    """Whether a vehicle moves on a lane against its direction, with no lane of its own direction near."""
    against = ((relations.distances < _MAX_DISTANCE) & (relations.angles > _MIN_ANGLE)).any(1)
    along = ((relations.distances < _ALLOWED_DISTANCE) & (relations.angles < _ALLOWED_ANGLE)).any(1)
    moving = relations.is_vehicle & (relations.speeds > _MIN_SPEED)
    return bool((against & ~along & moving & relations.is_eligible).any())


WRONG_WAY_DRIVER = EventRule(
    "wrong-way driver",
    ("a wrong-way driver", "a vehicle driving the wrong way", "a vehicle on the wrong side"),
    r"wrong[- ]way|wrong (?:side|direction)|against (?:the )?traffic",
    _detect,
)
