"""Rare events."""

from __future__ import annotations

from scjax.language.analysis.rare_events import EVENTS as EVENT_NAMES
from scjax.language.attributes.base import Attribute

EVENTS = (
    Attribute(
        "event",
        "set",
        "Rare events that the scene shows.",
        lambda scene: scene.events,
        EVENT_NAMES,
    ),
)
