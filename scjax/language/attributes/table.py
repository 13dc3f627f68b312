"""The table of all attributes, in the order of the documentation, and what follows from it for one scene."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any, NamedTuple

from scjax.language.analysis.scene_analysis import Analysis, analyze
from scjax.language.attributes.agents import AGENTS
from scjax.language.attributes.base import UNSPECIFIED, Attribute
from scjax.language.attributes.ego import EGO
from scjax.language.attributes.events import EVENTS
from scjax.language.attributes.lanes import LANES
from scjax.language.attributes.relations import RELATIONS
from scjax.language.attributes.roads import ROADS
from scjax.language.attributes.signals import SIGNALS
from scjax.scene import Scene

GROUPS: dict[str, tuple[Attribute, ...]] = {
    "Road": ROADS,
    "Lanes": LANES,
    "Agents": AGENTS,
    "Relations to the ego": RELATIONS,
    "Signals": SIGNALS,
    "Ego": EGO,
    "Events": EVENTS,
}
ATTRIBUTES: dict[str, Attribute] = {item.name: item for group in GROUPS.values() for item in group}
"""Name -> attribute."""


class AttributeScore(NamedTuple):
    """How much of a request a scene shows.

    Attributes:
      share: of the requested attributes that hold; 1 where nothing is requested.
      misses: name -> what was measured instead.
    """

    share: float
    misses: dict[str, Any]


def measure_attributes(scene: Scene | Analysis) -> dict[str, Any]:
    """Name -> measurement of every attribute of one scene; ``Attribute.kind`` says in which form."""
    analysis = scene if isinstance(scene, Analysis) else analyze(scene)
    return {name: attribute.measure(analysis) for name, attribute in ATTRIBUTES.items()}


def check_measurements(values: Any) -> dict[str, Any]:
    """Measurements of a scene as ``measure_attributes`` gives them, from their JSON form.

    Raises:
      ValueError: names the attribute that is missing, unknown, or of another form.
    """
    if not isinstance(values, dict) or values.keys() != ATTRIBUTES.keys():
        raise ValueError("these are not the measurements of all attributes")
    return {name: attribute.check_measured(values[name]) for name, attribute in ATTRIBUTES.items()}


def check_attributes(request: Any) -> dict[str, Any]:
    """A request in its normal form, without what it leaves unspecified.

    Args:
      request: a mapping, name -> value, bool, number, [least, most] or list of values, see ``base.TAKES``; None and
        "unspecified" ask nothing.

    Raises:
      ValueError: an unknown name, or a request that its attribute does not take.
    """
    if not isinstance(request, Mapping):
        raise ValueError(f"attributes must map names to values, not be a {type(request).__name__}: give a dict")
    normal = {}
    for name, value in request.items():
        if name not in ATTRIBUTES:
            near = difflib.get_close_matches(str(name), ATTRIBUTES, 1)
            cure = f"write {near[0]!r}" if near else f"choose from {', '.join(ATTRIBUTES)}"
            raise ValueError(f"there is no attribute {name!r}: {cure}")
        if value is not None and not (isinstance(value, str) and value == UNSPECIFIED):
            normal[name] = ATTRIBUTES[name].check(value)
    return normal


def score_attributes(scene: Scene | Analysis, request: Any) -> AttributeScore:
    """The score of a scene against a request, which is checked as in ``check_attributes``."""
    normal = check_attributes(request)
    analysis = scene if isinstance(scene, Analysis) else analyze(scene)
    measured = {name: ATTRIBUTES[name].measure(analysis) for name in normal}
    misses = {
        name: measured[name] for name, value in normal.items() if not ATTRIBUTES[name].holds(value, measured[name])
    }
    return AttributeScore(1 - len(misses) / max(len(normal), 1), misses)
