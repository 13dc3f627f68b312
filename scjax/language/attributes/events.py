"""Rare events."""

from __future__ import annotations

from scjax.language.analysis.rare_events import EVENTS as EVENT_NAMES
from scjax.language.analysis.rare_events import find_rare_events
from scjax.language.attributes.base import Attribute

EVENTS = (
    Attribute(
        "event",
        "set",
        "Rare events that the scene shows.",
        find_rare_events,
        EVENT_NAMES,
    ),
)
