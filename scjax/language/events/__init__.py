"""Rare events: one file per event, each with a rule, caption phrases and a prompt pattern.

To add an event, write a file with an ``EventRule`` and add the rule to ``RULES``. To show it in synthetic worlds, add
a file to ``scjax.synthetic.events``.
"""

from __future__ import annotations

from scjax.language.events.base import EventRule, relate_agents_to_lanes
from scjax.language.events.cut_in import CUT_IN
from scjax.language.events.emergency_corridor import EMERGENCY_CORRIDOR
from scjax.language.events.jaywalker import JAYWALKER
from scjax.language.events.stopped_vehicle import DOUBLE_PARKING, STOPPED_VEHICLE
from scjax.language.events.work_zone import WORK_ZONE
from scjax.language.events.wrong_way_driver import WRONG_WAY_DRIVER
from scjax.language.intersections import Intersection
from scjax.language.road import Road
from scjax.scene import Scene

RULES: tuple[EventRule, ...] = (
    WRONG_WAY_DRIVER,
    JAYWALKER,
    STOPPED_VEHICLE,
    DOUBLE_PARKING,
    EMERGENCY_CORRIDOR,
    CUT_IN,
    WORK_ZONE,
)
"""The order is the order of events in facts and captions; synthetic worlds draw events by their place in it."""

EVENTS: tuple[str, ...] = tuple(rule.event for rule in RULES)


def find_events(scene: Scene, road: Road, intersections: list[Intersection]) -> tuple[str, ...]:
    """Names of the events in one scene without padding, each at most once; agent 0 is the ego."""
    if not len(road) or len(scene.agents) < 2:
        return ()
    relations = relate_agents_to_lanes(scene, road, intersections)
    return tuple(rule.event for rule in RULES if rule.detect(relations))
