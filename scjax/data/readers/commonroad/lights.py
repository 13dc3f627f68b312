"""Traffic lights of a CommonRoad file -> states of the lanes that they control."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.data.readers.commonroad.lanelets import points_of, references
from scjax.data.readers.vocabulary import SIGNAL_WORDS, look_up
from scjax.data.readers.xml_elements import Element
from scjax.scene import MapLane, Signal

_DIRECTIONS = {
    "left": ("left",),
    "right": ("right",),
    "straight": ("straight",),
    "leftStraight": ("left", "straight"),
    "straightRight": ("straight", "right"),
    "leftRight": ("left", "right"),
    "all": ("left", "straight", "right"),
}
_WAYS = ("left", "straight", "right")


class LaneLights(NamedTuple):
    """States of lanes over time.

    Attributes:
      lane_ids: lanes that a light controls: those behind it.
      states: ``Signal`` of each at every step.
      positions: stop points [m].
    """

    lane_ids: tuple[str, ...]
    states: Int[np.ndarray, "signals steps"]
    positions: Float64[np.ndarray, "signals 3"]


def read_lights(root: Element, lanes: Mapping[str, MapLane], steps: int, unknown: Counter[str]) -> LaneLights:
    """The lights of all lanelets that refer to one.

    A lanelet refers to the light at its end. The light controls the lanelets that follow in the directions of the
    light, or the lanelet itself if none follows or if it is a way through an intersection.

    Raises:
      ValueError: something is missing or no number; says where.
    """
    lights = {element.text("id"): element for element in root.all("trafficLight")}
    phases = {name: _phases(element, unknown) for name, element in lights.items()}
    ways = _ways(root)
    inside = {name for targets in ways.values() for names in targets.values() for name in names}
    rows: dict[str, tuple[np.ndarray, list[float]]] = {}
    for element in root.all("lanelet"):
        name = element.text("id")
        controlled = _controlled(name, references(element, "trafficLightRef"), lights, ways, inside, lanes)
        for reference, controlled_lanes in controlled.items():
            states = _states(*phases[reference], steps)
            for lane in controlled_lanes:
                before = states if lane not in rows else np.maximum(states, rows[lane][0])  # stop counts most
                rows[lane] = (before, _stop_point(element, lanes, name, lane))
    return LaneLights(
        tuple(rows),
        np.array([states for states, _ in rows.values()], np.int8).reshape(-1, steps),
        np.array([place for _, place in rows.values()], np.float64).reshape(-1, 3),
    )


def _phases(element: Element, unknown: Counter[str]) -> tuple[np.ndarray, np.ndarray, int, bool]:
    """Durations [steps] and states of the cycle of a light, its offset [steps], and whether it works."""
    cycle = element.first("cycle") or element.first("trafficLightCycle")
    parts = cycle.all("cycleElement") if cycle is not None else []
    durations = np.array([part.only("duration").value() for part in parts], np.float64)
    colors = [part.only("color").content for part in parts]
    states = [look_up(SIGNAL_WORDS, word, Signal.UNKNOWN, "light color", unknown) for word in colors]
    offset = cycle.first("timeOffset") if cycle is not None else None
    if (durations < 0).any():
        raise element.fault("a phase of its cycle has a duration below 0")
    active = element.first("active")
    works = active is None or active.content.lower() != "false"
    return durations, np.array(states, np.int8), 0 if offset is None else int(offset.value()), works


def _states(durations: np.ndarray, states: np.ndarray, offset: int, works: bool, steps: int) -> np.ndarray:
    total = durations.sum() if len(durations) else 0.0
    if not works or total <= 0:
        return np.full(steps, Signal.UNKNOWN, np.int8)
    phase = np.mod(np.arange(steps) - offset, total)
    return states[np.searchsorted(np.cumsum(durations), phase, side="right")]


def _ways(root: Element) -> dict[str, dict[str, tuple[str, ...]]]:
    """Incoming lanelet -> direction -> lanelets that lead through the intersection."""
    ways: dict[str, dict[str, tuple[str, ...]]] = {}
    for intersection in root.all("intersection"):
        for incoming in intersection.all("incoming"):
            for name in references(incoming, "incomingLanelet"):
                targets = ways.setdefault(name, {})
                for way in _WAYS:
                    found = references(incoming, f"successors{way.title()}")  # from version 2020a on
                    targets[way] = targets.get(way, ()) + (found or references(incoming, f"outgoing{way.title()}"))
    return ways


def _controlled(
    name: str,
    names: Sequence[str],
    lights: Mapping[str, Element],
    ways: Mapping[str, Mapping[str, Sequence[str]]],
    inside: set[str],
    lanes: Mapping[str, MapLane],
) -> dict[str, list[str]]:
    """Lanes that each light of a lanelet controls; all that follow, if no light's direction fits one of them."""
    names = [reference for reference in names if reference in lights]
    if name in inside:
        return {reference: [name] for reference in names}
    following = [item for item in lanes[name].successors if item in lanes]
    by_light = {}
    for reference in names:
        direction = lights[reference].first("direction")
        directions = _DIRECTIONS.get("all" if direction is None else direction.content, _WAYS)
        named = {item for way in directions for item in ways.get(name, {}).get(way, ())}
        by_light[reference] = [item for item in following if item in named]
    if any(by_light.values()):
        return by_light
    return {reference: following or [name] for reference in names}


def _stop_point(element: Element, lanes: Mapping[str, MapLane], name: str, controlled: str) -> list[float]:
    """The middle of the stop line of a lanelet, or where the lane that the light controls begins."""
    line = element.first("stopLine")
    points = points_of(line) if line is not None else np.zeros((0, 3))
    if len(points):
        return points.mean(0).tolist()
    return lanes[name].points[-1].tolist() if controlled != name else lanes[name].points[0].tolist()
