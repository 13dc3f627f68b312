"""Signals of roads: which lanes traffic lights control. Signs are counted only."""

from __future__ import annotations

import dataclasses
import re
from collections import Counter
from collections.abc import Mapping, Sequence

from scjax.data.readers.opendrive.lane_lines import LaneKey, LaneLine
from scjax.data.readers.opendrive.roads import MapRoad
from scjax.data.readers.xml_elements import Element

CAR_LIGHTS = frozenset({"1000001", "1000008", "1000009", "1000010", "1000011", "1000012", "1000020"})
"""Types of lights for cars in the standard's own catalog (country OpenDRIVE): three lamps, one or two, arrows."""

OTHER_LIGHTS = frozenset({"1000002", "1000007", "1000013", "1000014", "1000015", "1000021", "1000022", "1000023"})
"""Types of lights for pedestrians, cyclists and trams, and of lights that open and close lanes."""

STOP_SIGNS, YIELD_SIGNS = frozenset({"206", "r1-1", "b2"}), frozenset({"205", "r1-2", "b1"})
"""Types in the catalogs of Germany, the United States and Sweden."""

_WAY_TO_JUNCTION = 60.0  # m that a light may stand before its junction


@dataclasses.dataclass(frozen=True)
class RoadSignal:
    """A traffic light for cars where it takes effect.

    Attributes:
      road: id of the road.
      s: place on it [m].
      lane_ids: lanes that the file names; None if it names none, so that all of a direction are meant.
      forward: True and False for traffic along and against the reference line, None for both.
    """

    road: str
    s: float
    lane_ids: frozenset[int] | None
    forward: bool | None


def read_signals(roads: Mapping[str, MapRoad]) -> tuple[list[RoadSignal], Counter[str]]:
    """Lights for cars on all roads, and the counts of what else there is.

    Raises:
      ValueError: something is missing or no number; says where.
    """
    notes: Counter[str] = Counter()
    references: list[tuple[MapRoad, Element]] = []
    lights: list[RoadSignal] = []
    car_lights: set[str] = set()
    for road in roads.values():
        group = road.element.first("signals")
        for element in group.children if group is not None else ():
            if element.tag == "signalReference":
                references.append((road, element))
            elif element.tag == "signal":
                kind = _kind(element)
                if kind == "car light":
                    car_lights.add(element.text("id"))
                    lights.append(_read_signal(road, element))
                else:
                    notes[f"{kind}, not read"] += 1
    lights += [_read_signal(road, element) for road, element in references if element.text("id") in car_lights]
    return [light for light in lights if light.lane_ids is None or light.lane_ids], notes


def _kind(element: Element) -> str:
    """What a <signal> is, in a word."""
    word = re.sub(r"[\s.]", "", element.text("type", "")).lower()
    if word in CAR_LIGHTS:
        return "car light"
    if word in OTHER_LIGHTS:
        return "lights for pedestrians, cyclists, trams or lanes"
    if word in STOP_SIGNS:
        return "stop signs"
    if word in YIELD_SIGNS:
        return "yield signs"
    return "dynamic signals of other types" if element.text("dynamic", "no") == "yes" else "signs of other types"


def _read_signal(road: MapRoad, element: Element) -> RoadSignal:
    """Where a <signal> or <signalReference> takes effect; a validity of lane 0 alone means no lane."""
    ranges = [(item.whole("fromLane"), item.whole("toLane")) for item in element.all("validity")]
    named = {
        lane.id
        for side in road.sides
        for section in side
        for lane in section.lanes
        if any(min(pair) <= lane.id <= max(pair) for pair in ranges)
    }
    along = {"+": True, "-": False}.get(element.text("orientation", "none"))
    return RoadSignal(road.id, element.number("s"), frozenset(named) if ranges else None, along)


def controlled_lanes(
    signals: Sequence[RoadSignal],
    roads: Mapping[str, MapRoad],
    lines: Mapping[LaneKey, LaneLine],
    successors: Mapping[LaneKey, Sequence[LaneKey]],
) -> list[LaneKey]:
    """The lanes that traffic lights control: those of a junction that begin behind the light.

    A light on a road outside of junctions controls the ways through the next junction. If there is none, it controls
    the lane that it stands on.
    """
    lanes: dict[LaneKey, None] = {}
    for signal in signals:
        road = roads[signal.road]
        for side in road.sides:
            index = next((k for k, part in enumerate(side) if signal.s <= part.end), len(side) - 1)
            for lane in side[index].lanes if side else ():
                key = LaneKey(road.id, index, lane.id)
                if key in lines and _applies(signal, lines[key]):
                    lanes |= dict.fromkeys(_ways_through(key, lines, successors))
    return list(lanes)


def _applies(signal: RoadSignal, line: LaneLine) -> bool:
    # Exporters disagree on the orientation of signals, so lanes that are named count more.
    if signal.lane_ids is not None:
        return line.lane.id in signal.lane_ids
    return signal.forward is None or signal.forward == line.lane.forward


def _ways_through(
    start: LaneKey, lines: Mapping[LaneKey, LaneLine], successors: Mapping[LaneKey, Sequence[LaneKey]]
) -> list[LaneKey]:
    """The first lanes in a junction from ``start`` on, or ``start`` itself."""
    if lines[start].in_junction:
        return [start]
    ways: list[LaneKey] = []
    seen, front = {start}, [(start, 0.0)]
    while front:
        key, distance = front.pop()
        for following in successors.get(key, ()):
            if following in seen:
                continue
            seen.add(following)
            if lines[following].in_junction:
                ways.append(following)
                continue
            length = distance + lines[following].length
            if length < _WAY_TO_JUNCTION:
                front.append((following, length))
    return ways or [start]
