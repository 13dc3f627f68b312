"""Plain English for a request, in the words that captions of training scenes use."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scjax.language.attributes.base import Bounds
from scjax.language.attributes.table import check_attributes

_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
_LAYOUTS = {
    "straight": "a straight road",
    "curve": "a curved road",
    "winding": "a winding road",
    "four-way": "a four-way intersection",
    "T": "a T-intersection",
    "Y": "a Y-intersection",
    "roundabout": "a roundabout",
    "merge": "a merge of two roads",
    "split": "a road that splits",
    "dead-end": "a dead end",
    "parking-lot": "a parking lot",
    "intersection": "an intersection",
    "multi-intersection": "a road with several side streets",
    "crossing-overpass": "an overpass",
}
_NOUNS = {
    "vehicles": ("vehicle", "vehicles"),
    "pedestrians": ("pedestrian", "pedestrians"),
    "cyclists": ("cyclist", "cyclists"),
    "static": ("cone", "cones"),
    "large": ("truck", "trucks"),
    "parked": ("parked vehicle", "parked vehicles"),
    "ahead": ("vehicle ahead", "vehicles ahead"),
    "behind": ("vehicle behind", "vehicles behind"),
    "oncoming": ("oncoming vehicle", "oncoming vehicles"),
    "crossing": ("crossing vehicle", "crossing vehicles"),
}
_EVENTS = {
    "wrong-way": "a wrong-way driver",
    "jaywalker": "a jaywalker crossing the road",
    "stopped-in-lane": "a vehicle stopped in its lane",
    "double-parking": "a double-parked vehicle",
    "emergency-corridor": "an emergency corridor",
    "cut-in": "a vehicle cutting in",
    "work-zone": "a work zone",
}
_EGO = {
    "stopped": "the ego vehicle is stopped",
    "slow": "the ego vehicle drives slowly",
    "moving": "the ego vehicle is moving",
    "fast": "the ego vehicle drives fast",
}


def request_text(request: Mapping[str, Any]) -> str:
    """One or two sentences for a request of attributes; "" where no part of it has words.

    Raises:
      ValueError: as in ``check_attributes``.
    """
    normal = check_attributes(request)
    head = _LAYOUTS.get(normal.get("layout", ""), "a road")
    parts = [_lanes(normal), *(_count(normal[name], *nouns) for name, nouns in _NOUNS.items() if name in normal)]
    if normal.get("signal") in ("red", "yellow", "green"):
        parts.append(f"a {normal['signal']} traffic light")
    parts += [f"a {side}-turn lane" for side in normal.get("turn_lane", ())]
    parts += [_EVENTS[name] for name in normal.get("event", ())]
    if normal.get("queue"):
        parts.append("a queue of vehicles")
    parts = [part for part in parts if part]
    sentences = [f"{head}{' with ' if parts else ''}{_listed(parts)}"] if parts or head != "a road" else []
    sentences += [_EGO[normal["ego"]]] if "ego" in normal else []
    return " ".join(f"{sentence[0].upper()}{sentence[1:]}." for sentence in sentences)


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""


def _lanes(normal: Mapping[str, Any]) -> str:
    same, opposite = (normal.get(name, (0, None)) for name in ("lanes_same", "lanes_opposite"))
    if same[0] != same[1]:
        return ""
    number = _number_word(int(same[0]))
    noun = "lane" if same[0] == 1 else "lanes"
    if same == opposite:
        return f"{number} {noun} in each direction"
    return f"{number} one-way {noun}" if normal.get("one_way") or opposite == (0, 0) else ""


def _count(bounds: Bounds, one: str, many: str) -> str:
    """Words for a range of counts: exact numbers, and vague ones for wide ranges."""
    least, most = bounds
    if most is None:
        return f"several {many}" if 2 < least < 6 else f"many {many}" if least >= 6 else f"a {one}" if least else ""
    middle = round((least + most) / 2)
    if most == 0:
        return f"no {many}"
    if most - least <= 2:
        return f"one {one}" if middle <= 1 else f"{_number_word(middle)} {many}"
    return f"a few {many}" if most <= 5 else f"several {many}" if least < 6 else f"many {many}"


def _number_word(count: int) -> str:
    return _NUMBERS[count] if count < len(_NUMBERS) else str(count)
