"""Requests that no scene can fulfill: pairs of attributes that contradict each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from scjax.language.attributes.roads import LAYOUTS
from scjax.language.attributes.table import ATTRIBUTES, check_attributes

_PARTS = {
    "vehicles": ("large", "parked", "stopped", "ahead", "behind", "left_lane", "right_lane", "oncoming", "crossing"),
    "pedestrians": ("pedestrians_on_road", "pedestrians_ahead"),
    "stopped": ("parked",),
}
"""Number -> numbers that are parts of it."""
_NEEDS = {
    "wrong-way": {"vehicles": 1},
    "jaywalker": {"pedestrians": 1, "pedestrians_on_road": 1},
    "stopped-in-lane": {"vehicles": 1, "stopped": 1},
    "double-parking": {"vehicles": 2, "stopped": 2},
    "emergency-corridor": {"vehicles": 3},
    "cut-in": {"vehicles": 1},
    "work-zone": {"static": 3},
}
"""Event -> least numbers that it takes; the ego may be one of those who take part, and counts nowhere."""
_JUNCTIONS = ("four-way", "T", "Y", "intersection", "multi-intersection")
_QUEUE_SIZE = 3
_TOGETHER = {
    "layout": (
        ("four-way", "T", "Y", "intersection", "multi-intersection", "roundabout", "parking-lot", "crossing-overpass"),
        ("straight", "no-intersection", "merge", "split", "dead-end", "parking-lot", "crossing-overpass"),
        ("curve", "no-intersection", "merge", "split", "dead-end", "parking-lot", "crossing-overpass"),
        ("winding", "curve"),
        ("winding", "no-intersection", "merge", "split", "dead-end", "crossing-overpass"),
        ("intersection", "merge", "split", "dead-end", "four-way", "T", "Y", "multi-intersection", "roundabout"),
    ),
    "signal": (("red", "any"), ("yellow", "any"), ("green", "any")),
    "ego": (("slow", "moving"), ("fast", "moving")),
    "not_layout": (LAYOUTS,),
}
"""Choice -> groups of values that one scene can show together."""


def find_contradictions(request: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Pairs of attributes of a request that cannot both hold, each once.

    Raises:
      ValueError: as in ``check_attributes``.
    """
    normal = check_attributes(request)
    pairs = (*_of_numbers(normal), *_of_lanes(normal), *_of_roads(normal), *_of_events(normal), *_of_sets(normal))
    return list(dict.fromkeys(pairs))


def least_numbers(request: Mapping[str, Any]) -> dict[str, int | float]:
    """Least numbers that a request in its normal form calls for, those of its parts, events and queue included."""
    least = {name: value[0] for name, value in request.items() if ATTRIBUTES[name].kind == "range"}

    def raise_to(name: str, number: int | float) -> None:
        least[name] = max(least.get(name, 0), number)

    for event in request.get("event", ()):
        for name, number in _NEEDS[event].items():
            raise_to(name, number)
    if request.get("queue"):
        raise_to("vehicles", _QUEUE_SIZE)
    for whole in reversed(_PARTS):  # parked vehicles are a part of the stopped ones, and these of all
        for part in _PARTS[whole]:
            raise_to(whole, least.get(part, 0))
    return least


def find_clashes(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """Attributes of which two requests in their normal form ask what no scene shows at once."""
    return [name for name in one if name in other and _clash(name, one[name], other[name])]


def _clash(name: str, one: Any, other: Any) -> bool:
    kind = ATTRIBUTES[name].kind
    if kind == "range":
        return max(one[0], other[0]) > min(math.inf if end is None else end for end in (one[1], other[1]))
    if kind == "flag":
        return one is not other
    pair = {one, other} if kind == "choice" else set()
    return len(pair) == 2 and not any(pair <= set(values) for values in _TOGETHER.get(name, ()))


def _least(request: Mapping[str, Any], name: str) -> int | float:
    return request[name][0] if name in request else 0


def _most(request: Mapping[str, Any], name: str) -> int | float:
    most = request[name][1] if name in request else None
    return math.inf if most is None else most


def _of_numbers(request: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for whole, parts in _PARTS.items():
        for part in parts:
            if _least(request, part) > _most(request, whole):
                yield part, whole
    if _most(request, "gap_ahead") < math.inf and _most(request, "ahead") < 1:
        yield "gap_ahead", "ahead"
    if request.get("queue") and _most(request, "vehicles") < _QUEUE_SIZE:
        yield "queue", "vehicles"


def _of_lanes(request: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    same, opposite = "lanes_same", "lanes_opposite"
    if "lanes_total" in request:
        if _least(request, same) + _least(request, opposite) > _most(request, "lanes_total"):
            yield same, "lanes_total"
        if _most(request, same) + _most(request, opposite) < _least(request, "lanes_total"):
            yield same, "lanes_total"
    is_one_way = request.get("one_way")
    comes_wrong = "wrong-way" in request.get("event", ())
    if is_one_way is True:
        if _least(request, opposite) > 0:
            yield "one_way", opposite
        if _least(request, "oncoming") > 0 and not comes_wrong:
            yield "one_way", "oncoming"
        if request.get("median"):
            yield "one_way", "median"
    if _most(request, opposite) < 1:
        if is_one_way is False:
            yield "one_way", opposite
        if request.get("median"):
            yield "median", opposite
        if _least(request, "oncoming") > 0 and not comes_wrong:
            yield "oncoming", opposite
    place = request.get("ego_lane")
    if place is not None and _most(request, same) < (3 if place == "middle" else 2):
        yield "ego_lane", same
    if _least(request, "ego_lane_index") > _most(request, same):
        yield "ego_lane_index", same
    if place == "leftmost" and _least(request, "ego_lane_index") > 1:
        yield "ego_lane", "ego_lane_index"
    if place in ("middle", "rightmost") and _most(request, "ego_lane_index") < 2:
        yield "ego_lane", "ego_lane_index"


def _of_roads(request: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    layout, other = request.get("layout"), request.get("not_layout")
    if layout is not None and layout == other:
        yield "layout", "not_layout"
    if other == "intersection" and layout in _JUNCTIONS:
        yield "layout", "not_layout"
    if other == "no-intersection" and layout in ("straight", "curve", "winding"):
        yield "layout", "not_layout"
    if "ego_arm" in request and layout not in (None, "T", "intersection", "multi-intersection"):
        yield "ego_arm", "layout"
    if "ego_arm" in request and other in ("T", "intersection"):
        yield "ego_arm", "not_layout"
    if "bend" in request and layout == "straight":
        yield "bend", "layout"


def _of_events(request: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for event in request.get("event", ()):
        for name, number in _NEEDS[event].items():
            if _most(request, name) < number:
                yield "event", name


def _of_sets(request: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for place in request.get("where", ()):
        name = place.partition(" ")[0]
        if _most(request, name) < 1 or (name == "parked" and _most(request, "vehicles") < 1):
            yield "where", name
    for pair in request.get("compare", ()):
        more, _, fewer = pair.partition(" > ")
        if _most(request, more) <= _least(request, fewer):
            yield "compare", more
