"""Work zone: several cones or barriers on a road or at its edge."""

from __future__ import annotations

from scjax.language.events.base import AgentLaneRelations, EventRule

_MIN_OBJECTS = 3
_MAX_DISTANCE = 8.0  # m from the centerline of the nearest lane


def _detect(relations: AgentLaneRelations) -> bool:
    near = relations.is_static & (relations.distances.min(-1) < _MAX_DISTANCE)
    return int(near.sum()) >= _MIN_OBJECTS


WORK_ZONE = EventRule(
    "work zone",
    ("a work zone with cones", "road works at the edge of a lane"),
    r"work ?zone|road ?works?|construction (?:zone|site)|lane closed by",
    _detect,
)
