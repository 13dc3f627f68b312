"""Styles in which people write, and the plans by which phrasings become a text."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from scjax.language.grammar.quantities import NUMBERED, StatedQuantity

RELATIONS = (
    *("ahead", "behind", "gap_ahead", "left_lane", "right_lane", "oncoming", "crossing", "queue", "where"),
    *("pedestrians_ahead", "ego_lane", "ego_lane_index", "ego_arm"),
)


@dataclasses.dataclass(frozen=True)
class Plan:
    """How a text is put together.

    Attributes:
      registers: of phrasings, the preferred one first.
      voice: who speaks, a key of the voices in ``words.toml``; "" for any.
    """

    registers: tuple[str, ...]
    voice: str = ""


PLANS = {
    "keys": Plan(("key", "noun")),
    "spoken": Plan(("said", "noun"), "first"),
    "wish": Plan(("noun", "said"), "first"),
    "test": Plan(("test", "key"), "third"),
    "sections": Plan(("noun", "key"), "third"),
    "paragraph": Plan(("fact", "noun"), "third"),
    "slangy": Plan(("slang", "said", "key"), "first"),
}


@dataclasses.dataclass(frozen=True)
class Style:
    """A way of writing.

    Attributes:
      plans: to draw from.
      size: least and largest number of phrasings.
      focus: factor of the likelihood with which a statement is made.
      noise: likelihood of mistakes.
    """

    plans: tuple[str, ...]
    size: tuple[int, int]
    focus: Callable[[Mapping[str, Any], Mapping[str, StatedQuantity]], float]
    noise: float = 0.12


def is_negative(request: Mapping[str, Any]) -> bool:
    """Whether a request asks only for what is not there."""
    return all(
        name == "not_layout"
        or value is False
        or value in ("none", "no-intersection", "flat")
        or (isinstance(value, tuple) and value[-1] == 0)
        for name, value in request.items()
    )


def _plain(request: Mapping[str, Any], quantities: Mapping[str, StatedQuantity]) -> float:
    return 0.15 if is_negative(request) else 1.0


def _negations(request: Mapping[str, Any], quantities: Mapping[str, StatedQuantity]) -> float:
    return 1.0 if is_negative(request) else 0.2


def _numbers(request: Mapping[str, Any], quantities: Mapping[str, StatedQuantity]) -> float:
    if any(quantity.kind in NUMBERED for quantity in quantities.values()) or "compare" in request:
        return 1.0
    return 0.1


def _relations(request: Mapping[str, Any], quantities: Mapping[str, StatedQuantity]) -> float:
    if not any(name in RELATIONS for name in request):
        return 0.15
    return 0.4 if is_negative(request) else 1.0


def _events(request: Mapping[str, Any], quantities: Mapping[str, StatedQuantity]) -> float:
    return 1.0 if "event" in request else 0.5 * _plain(request, quantities)


STYLES = {
    "terse": Style(("keys",), (1, 4), _plain),
    "everyday": Style(("spoken", "wish"), (1, 5), _plain),
    "engineer": Style(("test",), (2, 7), _plain, 0.03),
    "caption": Style(("sections", "paragraph"), (3, 8), _plain, 0.02),
    "negation": Style(("keys", "spoken", "wish", "paragraph"), (1, 5), _negations),
    "numbers": Style(("keys", "spoken", "wish", "test"), (1, 4), _numbers),
    "spatial": Style(("keys", "spoken", "wish", "paragraph"), (1, 4), _relations),
    "rare": Style(("keys", "spoken", "wish", "paragraph", "test"), (1, 4), _events),
    "variants": Style(("slangy", "keys", "spoken"), (1, 5), _plain, 0.8),
    "languages": Style(("keys", "spoken", "wish", "sections"), (1, 5), _plain, 0.15),
}
"""Style -> how it is written. "languages" is that of all languages but English."""
