"""An .osm file as tables: nodes in meters, ways, and relations with their tags."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64

from scjax.data.readers.lanelet2.projection import project_degrees
from scjax.data.readers.xml_elements import Element
from scjax.scene.limits import MAX_COORDINATE

_LOCAL = ("local_x", "local_y")  # tags of meters, which take the place of degrees


@dataclasses.dataclass(frozen=True)
class Osm:
    """Tables of a file by id.

    Attributes:
      row_of: row of each node in ``points``.
      points: of the nodes [m]; z is NaN where it is not recorded.
      ways: node ids of each way.
      relations: elements by id.
      tags: of ways and relations, by kind and id.
      origin: latitude and longitude of x = 0, y = 0 [degrees]; None for maps in meters.
    """

    row_of: Mapping[str, int]
    points: Float64[np.ndarray, "nodes 3"]
    ways: Mapping[str, list[str]]
    relations: Mapping[str, Element]
    tags: Mapping[tuple[str, str], dict[str, str]]
    origin: tuple[float, float] | None

    def way_points(self, nodes: list[str]) -> Float64[np.ndarray, "points 3"]:
        """Points of nodes [m]."""
        return self.points[[self.row_of[node] for node in nodes]]


def read_osm(root: Element) -> Osm:
    """The tables of an <osm> element.

    Raises:
      ValueError: a node, way or relation is contradictory; says where.
    """
    nodes = _by_id(root, "node")
    points, origin = _points(nodes)
    ways: dict[str, list[str]] = {}
    for name, element in _by_id(root, "way").items():
        ways[name] = [child.text("ref") for child in element.all("nd")]
        if absent := next((node for node in ways[name] if node not in nodes), None):
            raise element.fault(f"its node {absent!r:.40} is not in the file")
    relations = _by_id(root, "relation")
    tags = {("way", name): tags_of(element) for name, element in _by_id(root, "way").items()}
    tags |= {("relation", name): tags_of(element) for name, element in relations.items()}
    return Osm({name: row for row, name in enumerate(nodes)}, points, ways, relations, tags, origin)


def tags_of(element: Element) -> dict[str, str]:
    """The <tag> children as a dict."""
    return {tag.text("k"): tag.text("v", "") for tag in element.all("tag")}


def _by_id(root: Element, tag: str) -> dict[str, Element]:
    elements: dict[str, Element] = {}
    for element in root.all(tag):
        if element.text("action", "") == "delete":  # JOSM keeps what was deleted
            continue
        name = element.text("id")
        if name in elements:
            raise element.fault(f"another {tag} has the same id")
        elements[name] = element
    return elements


def _points(nodes: Mapping[str, Element]) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Points of all nodes [m], and the origin of their frame."""
    tags = [tags_of(element) for element in nodes.values()]
    points = np.full((len(nodes), 3), np.nan)
    points[:, 2] = [_tag_number(element, item, "ele") for element, item in zip(nodes.values(), tags, strict=True)]
    if nodes and all(item.get(name) for item in tags for name in _LOCAL):
        for column, name in enumerate(_LOCAL):
            points[:, column] = [_tag_number(e, item, name) for e, item in zip(nodes.values(), tags, strict=True)]
        return points, None
    latitude = np.array([element.number("lat", most=89.9) for element in nodes.values()], np.float64)
    longitude = np.array([element.number("lon", most=180.0) for element in nodes.values()], np.float64)
    if not len(latitude):
        return points, None
    origin = float(np.median(latitude).round(4)), float(np.median(longitude).round(4))
    far = np.flatnonzero((np.abs(latitude - origin[0]) > 2) | (np.abs(longitude - origin[1]) > 3))
    if len(far):
        raise list(nodes.values())[far[0]].fault("it lies more than 200 km from the middle of the map")
    points[:, :2] = project_degrees(latitude, longitude, origin)
    return points, origin


def _tag_number(element: Element, tags: Mapping[str, str], name: str) -> float:
    """The number in a tag [m]; NaN if there is none."""
    text = tags.get(name)
    if not text:
        return float("nan")
    try:
        value = float(text)
    except ValueError as error:
        raise element.fault(f"its tag {name} is {text!r:.40}, not a number") from error
    if not abs(value) < MAX_COORDINATE:
        raise element.fault(f"its tag {name} is {text!r:.40}: it must be finite")
    return value
