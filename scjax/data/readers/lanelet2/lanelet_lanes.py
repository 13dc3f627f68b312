"""Lanelets of an .osm file -> lanes: directions, middle lines, and which lanelets follow or lie beside each other."""

from __future__ import annotations

import dataclasses
from collections import Counter, defaultdict
from collections.abc import Mapping

import numpy as np

from scjax.data.readers.bounds import middle_line
from scjax.data.readers.lanelet2.osm import Osm
from scjax.data.readers.vocabulary import LANE_WORDS, NOT_FOR_CARS, look_up
from scjax.data.readers.xml_elements import Element
from scjax.scene import LaneNeighbor, MapLane

_CAR_USERS = ("participant:vehicle", "participant:vehicle:car")


@dataclasses.dataclass(frozen=True)
class Lanelet:
    """One lanelet.

    Attributes:
      element: for messages.
      left, right: node ids of the bounds, in driving direction.
      center: its middle line in driving direction [m].
      tags: of the relation.
      rules: ids of its regulatory elements.
    """

    element: Element
    left: list[str]
    right: list[str]
    center: np.ndarray
    tags: Mapping[str, str]
    rules: tuple[str, ...]


def read_lanelet_relations(osm: Osm) -> dict[str, Lanelet]:
    """All lanelets by id.

    Raises:
      ValueError: there is none, or a bound is missing or not in one piece; says where.
    """
    lanelets = {
        name: _lanelet(element, osm, osm.tags["relation", name])
        for name, element in osm.relations.items()
        if osm.tags["relation", name].get("type") == "lanelet"
    }
    if not lanelets:
        raise ValueError("it has no relation of type lanelet: give a Lanelet2 map, not one of OpenStreetMap's streets")
    return lanelets


def lanelet_lanes(lanelets: Mapping[str, Lanelet], unknown: Counter[str], notes: Counter[str]) -> dict[str, MapLane]:
    """The lanes by id, with connections and neighbors by shared nodes, as Lanelet2 finds them.

    Args:
      unknown, notes: count words that no table has, and what is not read.
    """
    starts: dict[tuple[str, str], list[str]] = defaultdict(list)
    ends: dict[tuple[str, str], list[str]] = defaultdict(list)
    by_right: dict[tuple[str, ...], list[str]] = defaultdict(list)
    by_left: dict[tuple[str, ...], list[str]] = defaultdict(list)
    types = {name: _lanelet_type(lanelet.tags, unknown) for name, lanelet in lanelets.items()}
    for name, lanelet in lanelets.items():
        starts[lanelet.left[0], lanelet.right[0]].append(name)
        ends[lanelet.left[-1], lanelet.right[-1]].append(name)
        by_left[tuple(lanelet.left)].append(name)
        by_right[tuple(lanelet.right)].append(name)
        if lanelet.tags.get("one_way") == "no" and types[name] not in ("bike_lane", NOT_FOR_CARS):
            notes["lanelets for both directions, read in one"] += 1

    def beside(name: str, others: list[str]) -> tuple[LaneNeighbor, ...]:
        last = len(lanelets[name].center) - 1
        return tuple(
            LaneNeighbor(o, 0, last, 0, len(lanelets[o].center) - 1) for o in others if types[o] == types[name]
        )

    def follow(name: str, others: list[str]) -> tuple[str, ...]:
        walked = types[name] == NOT_FOR_CARS
        return tuple(other for other in others if other != name and (types[other] == NOT_FOR_CARS) == walked)

    return {
        name: MapLane(
            id=name,
            lane_type=types[name],
            points=lanelet.center,
            predecessors=follow(name, ends[lanelet.left[0], lanelet.right[0]]),
            successors=follow(name, starts[lanelet.left[-1], lanelet.right[-1]]),
            left_neighbors=beside(name, by_right[tuple(lanelet.left)]),
            right_neighbors=beside(name, by_left[tuple(lanelet.right)]),
        )
        for name, lanelet in lanelets.items()
    }


def _lanelet(element: Element, osm: Osm, tags: Mapping[str, str]) -> Lanelet:
    bounds = {role: _bound(element, osm, role) for role in ("left", "right")}
    left, right = _aligned(bounds["left"], bounds["right"], osm)
    given = _bound(element, osm, "centerline") if _members(element, "way", "centerline") else []
    lines = [osm.way_points(nodes) for nodes in (left, right)]
    center = osm.way_points(given) if len(given) >= 2 else middle_line(*lines)
    if np.isnan(center[:, 2]).any():
        center[:, 2] = np.nan
    return Lanelet(element, left, right, center, tags, tuple(_members(element, "relation", "regulatory_element")))


def _members(element: Element, kind: str, role: str) -> list[str]:
    return [
        child.text("ref")
        for child in element.all("member")
        if child.text("type", "") == kind and child.text("role", "") == role
    ]


def _bound(element: Element, osm: Osm, role: str) -> list[str]:
    """Node ids of a bound, of several ways joined end to end."""
    names = _members(element, "way", role)
    if not names:
        raise element.fault(f"has no {role} bound")
    if absent := next((name for name in names if name not in osm.ways), None):
        raise element.fault(f"its {role} bound, way {absent!r:.40}, is not in the file")
    nodes = list(osm.ways[names[0]])
    for name in names[1:]:
        following = list(osm.ways[name])
        if not nodes or not following:
            continue
        if nodes[-1] not in (following[0], following[-1]):
            nodes.reverse()
        if following[0] != nodes[-1]:
            following.reverse()
        if following[0] != nodes[-1]:
            raise element.fault(f"its {role} bound is not in one piece")
        nodes += following[1:]
    if len(nodes) < 2:
        raise element.fault(f"its {role} bound has {len(nodes)} nodes, not two or more")
    return nodes


def _aligned(left: list[str], right: list[str], osm: Osm) -> tuple[list[str], list[str]]:
    """Both bounds in driving direction: the middle of each lies on the proper side of the other."""
    a, b = osm.way_points(left)[:, :2], osm.way_points(right)[:, :2]
    if _side(_middle(b), a) > 0:
        left, a = left[::-1], a[::-1]
    if _side(_middle(a), b) < 0:
        right = right[::-1]
    return left, right


def _middle(line: np.ndarray) -> np.ndarray:
    return line[len(line) // 2] if len(line) > 2 else line.mean(0)


def _side(point: np.ndarray, line: np.ndarray) -> float:
    """Above 0 if a point lies on the left of a polyline, below 0 on the right: as its nearest part sees it."""
    steps = np.diff(line, axis=0)
    lengths = np.maximum(np.hypot(*steps.T), 1e-9)
    ratio = np.clip(((point - line[:-1]) * steps).sum(1) / lengths**2, 0.0, 1.0)
    distance = np.hypot(*(point - line[:-1] - ratio[:, None] * steps).T)
    nearest = distance <= distance.min() + 1e-9  # two parts at a corner, whose directions count together
    direction = (steps[nearest] / lengths[nearest][:, None]).sum(0)
    row = int(np.argmax(nearest))
    offset = point - line[row] - ratio[row] * steps[row]
    return float(direction[0] * offset[1] - direction[1] * offset[0])


def _lanelet_type(tags: Mapping[str, str], unknown: Counter[str]) -> str | None:
    """The type of a lane: who may use it counts more than what it is called."""
    word = tags.get("subtype", "road")
    lane_type = look_up(LANE_WORDS, word, None, "lanelet subtype", unknown)
    users = {key for key, value in tags.items() if key.startswith("participant:") and value == "yes"}
    if users and not users & set(_CAR_USERS):
        if users == {"participant:bicycle"}:
            return "bike_lane"
        return lane_type if lane_type == "bus_lane" else NOT_FOR_CARS
    return "surface_street" if lane_type == "freeway" and tags.get("location") == "urban" else lane_type
