"""What a prompt asks for, read by rule: the counterpart of ``text.write``, for prompts in anybody's words.

Only plain statements are read; what is not recognised is not asked for. Numbers count as said, vague words as ranges.
"""

from __future__ import annotations

import dataclasses
import re

from scjax.language.facts import Facts

_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
_NUMBER = {word: k for k, word in enumerate(_WORDS)} | {"a single": 1, "a": 1, "an": 1}
_MOST = 60
_VAGUE = {
    "a couple of": (2, 3), "a few": (2, 4), "few": (2, 4), "some": (2, 6), "several": (3, 9), "multiple": (2, 12),
    "many": (6, _MOST), "numerous": (6, _MOST), "heavy": (8, _MOST),
}  # fmt: skip
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
_EVENTS = (
    ("wrong-way driver", r"wrong[- ]way|wrong (?:side|direction)|against (?:the )?traffic"),
    ("jaywalker", r"jaywalk|away from any crosswalk"),
    ("stopped vehicle in lane", r"(?:stopped|broken[- ]down|stalled) (?:vehicle|car)?.*lane|blocking a lane"),
    ("double parking", r"double[- ]park"),
    ("emergency corridor", r"emergency (?:corridor|lane)|making way for an emergency"),
    ("cut-in", r"cut(?:s|ting)?[- ]in|cut-in"),
)
_SIGNALS = (
    ("red", r"\bred (?:traffic )?(?:light|signal)"),
    ("green", r"\bgreen (?:traffic )?(?:light|signal|path)|lanes green"),
    ("yellow", r"\b(?:yellow|amber) (?:traffic )?(?:light|signal)"),
)
_DENIED = r"\b(?:no|not|without|never|nobody|nothing)(?: an?| any| the)?(?: \w+)? $"
_RELATION = (
    r"(?! (?:ahead|behind|in |on the (?:left|crossing|opposite)|oncoming|approaching|following|turning|parked|"
    r"crossing|from|beside|to the|off|lane))"
)


@dataclasses.dataclass(frozen=True)
class PromptSpec:
    """What a prompt says; None and empty: nothing.

    Attributes:
      layout: one of ``Facts.layout``. signal: colour of the ego's light. events: rare events.
      vehicles, pedestrians, cyclists: fewest and most that fit the words; the ego is no vehicle of these.
      exact: whether the number of vehicles was said as a number.
    """

    layout: str | None = None
    vehicles: tuple[int, int] | None = None
    exact: bool = False
    pedestrians: tuple[int, int] | None = None
    cyclists: tuple[int, int] | None = None
    signal: str | None = None
    events: tuple[str, ...] = ()


def parse_prompt(text: str) -> PromptSpec:
    """What ``text`` asks for."""
    plain = " ".join(text.lower().replace("–", "-").split())
    vehicles, exact = _amount(plain, r"(?:vehicles?|cars?)")
    return PromptSpec(
        layout=next((name for name, pattern in _LAYOUTS if re.search(pattern, plain)), None),
        vehicles=vehicles, exact=exact,
        pedestrians=_amount(plain, r"(?:pedestrians?|people|persons?)")[0],
        cyclists=_amount(plain, r"(?:cyclists?|bicycles?|bikes?)")[0],
        signal=next((name for name, pattern in _SIGNALS if _wanted(pattern, plain)), None),
        events=tuple(name for name, pattern in _EVENTS if _wanted(pattern, plain)),
    )  # fmt: skip


def check(asked: PromptSpec, facts: Facts) -> dict[str, bool]:
    """Attribute -> whether a scene shows it, for every attribute that was asked for.

    Vehicles in a number may be off by one or by a fifth; intersections count by their kind, whatever else there is.
    """
    traffic = facts.traffic
    found: dict[str, bool] = {}
    if asked.layout in ("four-way", "T", "complex", "roundabout"):
        found["intersection"] = asked.layout in (facts.layout, facts.intersection)
    elif asked.layout in ("straight", "curve"):
        # A gentle bend is called either.
        gentle = (facts.curve or "").startswith("gently")
        bent = facts.curve in ("left", "right", "winding")
        plain = facts.intersection is None and facts.layout != "roundabout"
        found["curved or straight"] = plain and (gentle or bent == (asked.layout == "curve"))
    elif asked.layout is not None:
        found["layout"] = facts.layout == asked.layout
    if asked.vehicles is not None:
        low, high = asked.vehicles
        slack = max(1, round(0.2 * high)) if asked.exact else 0
        name = "vehicles, number" if asked.exact else "vehicles, vague"
        found[name] = low - slack <= traffic.vehicles <= high + slack
    if asked.pedestrians is not None:
        found["pedestrians"] = (traffic.pedestrians > 0) == (asked.pedestrians[1] > 0)
    if asked.cyclists is not None:
        found["cyclists"] = (traffic.cyclists > 0) == (asked.cyclists[1] > 0)
    if asked.signal is not None:
        found["signal"] = facts.signals == asked.signal
    return found | {f"event: {event}": event in facts.events for event in asked.events}


def _wanted(pattern: str, text: str) -> bool:
    """Whether the text says ``pattern`` without denying it, as in "no" or "without any" before it."""
    return any(not re.search(_DENIED, text[: found.start()]) for found in re.finditer(pattern, text))


def _amount(text: str, nouns: str) -> tuple[tuple[int, int] | None, bool]:
    """Range that the text gives for something, and whether as a number; those "ahead", "parked", ... are no total."""
    words = "|".join(sorted(map(re.escape, [*_NUMBER, *_VAGUE]), key=len, reverse=True))
    match = re.search(rf"\b({words}|\d+) {_ADJECTIVES}{nouns}\b{_RELATION}", text)
    if match is None:
        return None, False
    said = match.group(1)
    if said in _VAGUE:
        return _VAGUE[said], False
    if said in ("a", "an"):
        return (1, _MOST), False
    number = int(said) if said.isdigit() else _NUMBER[said]
    return (number, number), said != "no"
