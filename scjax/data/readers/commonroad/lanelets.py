"""Lanelets of a CommonRoad file -> lanes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from scjax.data.readers.bounds import middle_line
from scjax.data.readers.vocabulary import LANE_WORDS, NOT_FOR_CARS, look_up
from scjax.data.readers.xml_elements import Element
from scjax.scene import LaneNeighbor, MapLane
from scjax.scene.limits import MAX_COORDINATE

_CARS = frozenset({"vehicle", "car", "truck", "bus", "taxi", "priorityVehicle", "motorcycle"})


def read_lanelets(root: Element, unknown: Counter[str]) -> dict[str, MapLane]:
    """The lanes by id, in the order of the file.

    Args:
      unknown: counts words that no table has.

    Raises:
      ValueError: something is missing, absurd or contradictory; says where.
    """
    elements: dict[str, Element] = {}
    for element in root.all("lanelet"):
        name = element.text("id")
        if name in elements:
            raise element.fault("another lanelet has the same id")
        elements[name] = element
    if not elements:
        raise ValueError(f"line {root.line}, <{root.tag}>: has no <lanelet>: give a file with a road network")
    lines = {name: _center(element) for name, element in elements.items()}
    counts = {name: len(line) for name, line in lines.items()}
    return {name: _lane(name, element, lines[name], counts, unknown) for name, element in elements.items()}


def points_of(element: Element) -> np.ndarray:
    """The <point> children, [points, 3] m; z is NaN where they have none."""
    return np.array([point_of(item) for item in element.all("point")], np.float64).reshape(-1, 3)


def point_of(element: Element) -> list[float]:
    """x, y, z of a <point> [m]; z is NaN if it has none."""
    z = element.first("z")
    plane = [element.only(axis).value(MAX_COORDINATE) for axis in ("x", "y")]
    return [*plane, float("nan") if z is None else z.value(MAX_COORDINATE)]


def references(element: Element, tag: str) -> tuple[str, ...]:
    """Ids that children of this name refer to, in order."""
    return tuple(child.text("ref") for child in element.all(tag))


def _center(element: Element) -> np.ndarray:
    """The middle of both bounds, point by point, as the format defines it."""
    left, right = (points_of(element.only(tag)) for tag in ("leftBound", "rightBound"))
    for tag, bound in (("leftBound", left), ("rightBound", right)):
        if len(bound) < 2:
            raise element.fault(f"its <{tag}> has {len(bound)} points, not two or more")
    line = (left + right) / 2 if len(left) == len(right) else middle_line(left, right)
    if np.isnan(line[:, 2]).any():
        line[:, 2] = np.nan
    return line


def _lane(name: str, element: Element, line: np.ndarray, counts: dict[str, int], unknown: Counter[str]) -> MapLane:
    return MapLane(
        id=name,
        lane_type=_lane_type(element, unknown),
        points=line,
        predecessors=references(element, "predecessor"),
        successors=references(element, "successor"),
        left_neighbors=_beside(element, "adjacentLeft", len(line), counts),
        right_neighbors=_beside(element, "adjacentRight", len(line), counts),
    )


def _beside(element: Element, tag: str, count: int, counts: dict[str, int]) -> tuple[LaneNeighbor, ...]:
    """The lanelet beside this one along all of it, if traffic uses it in the same direction."""
    return tuple(
        LaneNeighbor(child.text("ref"), 0, count - 1, 0, counts[child.text("ref")] - 1)
        for child in element.all(tag)
        if child.text("drivingDir", "same") == "same" and child.text("ref") in counts
    )


def _lane_type(element: Element, unknown: Counter[str]) -> str | None:
    """The most particular of the types of a lanelet; of those that no car may use, what they are for."""
    words = [child.content for child in element.all("laneletType") if child.content]
    types = [look_up(LANE_WORDS, word, None, "lanelet type", unknown) for word in words]
    users = {child.content for tag in ("userOneWay", "userBidirectional") for child in element.all(tag)} - {""}
    if users and not users & _CARS:
        return "bike_lane" if users == {"bicycle"} else NOT_FOR_CARS
    return _most_particular(types)


def _most_particular(types: Sequence[str | None]) -> str | None:
    order = ("bus_lane", "bike_lane", NOT_FOR_CARS, "freeway", "surface_street")
    return next((name for name in order if name in types), None)
