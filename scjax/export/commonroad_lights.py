"""Signals as CommonRoad traffic lights: at the end of the lanelets before the lane that they control."""

from __future__ import annotations

import itertools

import numpy as np

from scjax.export.base import Losses
from scjax.export.roads.lane_network import LaneNetwork, line_headings
from scjax.export.xml_text import XmlElement, add_element, add_point
from scjax.scene import Log, Signal

_COLORS = {Signal.UNKNOWN: "inactive", Signal.GO: "green", Signal.CAUTION: "yellow", Signal.STOP: "red"}
_STRAIGHT = float(np.deg2rad(25.0))  # between the first and last direction of a way that goes straight on


def add_lights(
    root: XmlElement, lanelets: list[XmlElement], log: Log, network: LaneNetwork, number: int, losses: Losses
) -> int:
    """Adds lights, and the intersections that say in which direction a light holds.

    Args:
      lanelets: elements of all lanes.
      number: first id that is free.

    Returns:
      The next id.
    """
    rows = {lane.id: row for row, lane in enumerate(network.lanes)}
    following: dict[int, list[int]] = {}  # as written: connections that turn too far are not
    for row, element in enumerate(lanelets):
        following[row] = [int(child.get("ref", 0)) - 1 for child in element.iter("successor")]
    lights: list[tuple[int, int, int]] = []  # lanelet before, lane, row of the signal
    for row, lane in enumerate(log.signal_lane_ids):
        before = [i for i, targets in following.items() if rows.get(lane) in targets]
        losses["signals of lanes that no lane leads to, left out"] += not before
        lights += [(i, rows[lane], row) for i in before]
    incoming = sorted({i for i, *_ in lights if len(following[i]) > 1})
    ways = {i: {j: _way(network, j) for j in following[i]} for i in incoming}
    for i, lane, row in lights:
        direction = ways[i][lane] if i in ways else "all"
        _add_light(root, number, log, row, network.lines[i][-1], direction)
        _insert_reference(lanelets[i], number)
        number += 1
    lit = {(i, lane) for i, lane, _ in lights}
    for i in incoming:
        shared = {ways[i][lane] for before, lane in lit if before == i}
        losses["lanes without a signal that share the light of another one"] += sum(
            way in shared and (i, j) not in lit for j, way in ways[i].items()
        )
    return _add_intersection(root, ways, number)


def _way(network: LaneNetwork, lane: int) -> str:
    headings = line_headings(network.lines[lane])
    turn = float(np.unwrap(headings)[-1] - headings[0])
    return "straight" if abs(turn) < _STRAIGHT else "left" if turn > 0 else "right"


def _add_light(root: XmlElement, number: int, log: Log, row: int, place: np.ndarray, direction: str) -> None:
    """A light whose cycle is the signal's states; after the log it begins again."""
    light = add_element(root, "trafficLight", id=number)
    cycle = add_element(light, "cycle")
    for state, steps in itertools.groupby(log.signal_states[row].tolist()):
        part = add_element(cycle, "cycleElement")
        add_element(part, "duration", str(len(list(steps))))
        add_element(part, "color", _COLORS[Signal(state)])
    known = log.signal_positions[row]
    x, y, _ = (place if np.isnan(known[:2]).any() else known).tolist()
    add_point(add_element(light, "position"), x, y)
    add_element(light, "direction", direction)
    add_element(light, "active", "true")


def _insert_reference(lanelet: XmlElement, light: int) -> None:
    add_element(lanelet, "trafficLightRef", ref=light)


def _add_intersection(root: XmlElement, ways: dict[int, dict[int, str]], number: int) -> int:
    """One intersection for each lanelet with ways of several directions and lights."""
    for i, targets in ways.items():
        intersection = add_element(root, "intersection", id=number)
        incoming = add_element(intersection, "incoming", id=number + 1)
        number += 2
        add_element(incoming, "incomingLanelet", ref=i + 1)
        for direction in ("right", "straight", "left"):
            for j in sorted(j for j, way in targets.items() if way == direction):
                add_element(incoming, f"successors{direction.title()}", ref=j + 1)
    return number
