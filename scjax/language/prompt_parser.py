"""Prompt parser: reads from a prompt what it asks for, by rules, and checks the facts of a scene against it.

The parser understands plain statements in any wording and ignores everything else. A number is exact, a vague word is
a range.
"""

from __future__ import annotations

import dataclasses
import re

from scjax.language.events import RULES
from scjax.language.facts import Facts
from scjax.language.wording import NUMBER_WORDS

_MAX_COUNT = 60
_MAX_CHARACTERS = 4000  # more than an encoder reads; the time of the patterns grows with the square of the length
_NUMBERS = {word: k for k, word in enumerate(NUMBER_WORDS)} | {"a single": 1, "a": 1, "an": 1}
_VAGUE_COUNTS = {
    "a couple of": (2, 3),
    "a few": (2, 4),
    "few": (2, 4),
    "some": (2, 6),
    "several": (3, 9),
    "multiple": (2, 12),
    "many": (6, _MAX_COUNT),
    "numerous": (6, _MAX_COUNT),
    "heavy": (8, _MAX_COUNT),
}
_COUNT_TOLERANCE = 0.2  # of an exact number of vehicles, at least 1
_ADJECTIVES = r"(?:other |more |moving |oncoming |parked |stopped )*"
_LAYOUTS = (
    ("roundabout", r"roundabout|traffic circle|rotary"),
    ("complex", r"complex (?:road topology|intersection|junction)"),
    ("four-way", r"four[- ]way|4[- ]way|crossroads?\b|cross[- ]?intersection|intersection of two roads"),
    ("T", r"\bt[- ]?(?:intersection|junction)|three[- ]way|3[- ]way"),
    ("parking area", r"parking (?:lot|area)"),
    ("straight", r"straight (?:\w+[- ]?\w* )?(?:road|street|stretch|lanes?)|road that runs straight"),
    ("curve", r"curved|in a bend|curving|bending|\bbend\b|\bcurve\b"),
)
_SIGNALS = (
    ("red", r"\bred (?:traffic )?(?:light|signal)"),
    ("green", r"\bgreen (?:traffic )?(?:light|signal|path)|lanes green"),
    ("yellow", r"\b(?:yellow|amber) (?:traffic )?(?:light|signal)"),
)
_NEGATION = r"\b(?:no|not|without|never|nobody|nothing)(?: an?| any| the)?(?: \w+)? $"
# A count with a relation ("two vehicles ahead") is no total.
_NO_RELATION = (
    r"(?! (?:ahead|behind|in |on the (?:left|crossing|opposite)|oncoming|approaching|following|turning|parked|"
    r"crossing|from|beside|to the|off|lane))"
)


@dataclasses.dataclass(frozen=True)
class PromptSpec:
    """What a prompt asks for; None and empty mean that it does not say.

    Attributes:
      layout: a value of ``Facts.layout``.
      vehicles, pedestrians, cyclists: smallest and largest count that fit the words; the ego does not count.
      exact: whether the prompt gives the number of vehicles as a number.
      signal: color of the ego's traffic light.
      events: rare events.
    """

    layout: str | None = None
    vehicles: tuple[int, int] | None = None
    exact: bool = False
    pedestrians: tuple[int, int] | None = None
    cyclists: tuple[int, int] | None = None
    signal: str | None = None
    events: tuple[str, ...] = ()


def parse_prompt(text: str) -> PromptSpec:
    """What the prompt ``text`` asks for; of a very long one only the beginning is read, as encoders do."""
    text = " ".join(text[:_MAX_CHARACTERS].lower().replace("–", "-").split())
    vehicles, exact = _parse_count(text, r"(?:vehicles?|cars?)")
    return PromptSpec(
        layout=next((name for name, pattern in _LAYOUTS if re.search(pattern, text)), None),
        vehicles=vehicles,
        exact=exact,
        pedestrians=_parse_count(text, r"(?:pedestrians?|people|persons?)")[0],
        cyclists=_parse_count(text, r"(?:cyclists?|bicycles?|bikes?)")[0],
        signal=next((name for name, pattern in _SIGNALS if _affirms(text, pattern)), None),
        events=tuple(rule.event for rule in RULES if _affirms(text, rule.prompt_pattern)),
    )


def check(spec: PromptSpec, facts: Facts) -> dict[str, bool]:
    """Whether a scene shows what a prompt asks for, per attribute in ``spec``.

    An exact number of vehicles may be off by one or by a fifth. An intersection may be any of the scene.
    """
    results: dict[str, bool] = {}
    if spec.layout in ("four-way", "T", "complex", "roundabout"):
        results["intersection"] = spec.layout in (facts.layout, facts.intersection)
    elif spec.layout in ("straight", "curve"):
        is_road = facts.intersection is None and facts.layout != "roundabout"
        # A gentle curve passes for straight and for curved.
        is_gentle = (facts.curve or "").startswith("gently")
        is_curved = facts.curve in ("left", "right", "winding")
        results["curved or straight"] = is_road and (is_gentle or is_curved == (spec.layout == "curve"))
    elif spec.layout is not None:
        results["layout"] = facts.layout == spec.layout
    traffic = facts.traffic
    if spec.vehicles is not None:
        low, high = spec.vehicles
        tolerance = max(1, round(_COUNT_TOLERANCE * high)) if spec.exact else 0
        name = "vehicles, number" if spec.exact else "vehicles, vague"
        results[name] = low - tolerance <= traffic.vehicles <= high + tolerance
    if spec.pedestrians is not None:
        results["pedestrians"] = (traffic.pedestrians > 0) == (spec.pedestrians[1] > 0)
    if spec.cyclists is not None:
        results["cyclists"] = (traffic.cyclists > 0) == (spec.cyclists[1] > 0)
    if spec.signal is not None:
        results["signal"] = facts.signals == spec.signal
    return results | {f"event: {event}": event in facts.events for event in spec.events}


def _affirms(text: str, pattern: str) -> bool:
    """Whether the text contains ``pattern`` without a negation ("no", "without any") before it."""
    return any(not re.search(_NEGATION, text[: match.start()]) for match in re.finditer(pattern, text))


def _parse_count(text: str, nouns: str) -> tuple[tuple[int, int] | None, bool]:
    """Range of a total that the text gives for ``nouns``, None without one, and whether it is an exact number."""
    words = "|".join(sorted(map(re.escape, [*_NUMBERS, *_VAGUE_COUNTS]), key=len, reverse=True))
    match = re.search(rf"\b({words}|\d{{1,6}}) {_ADJECTIVES}{nouns}\b{_NO_RELATION}", text)
    if match is None:
        return None, False
    word = match.group(1)
    if word in _VAGUE_COUNTS:
        return _VAGUE_COUNTS[word], False
    if word in ("a", "an"):
        return (1, _MAX_COUNT), False
    number = int(word) if word.isdigit() else _NUMBERS[word]
    return (number, number), word != "no"
