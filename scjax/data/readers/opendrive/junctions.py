"""Junctions: which lanes of incoming roads lead into which connecting roads."""

from __future__ import annotations

from typing import NamedTuple

from scjax.data.readers.opendrive.roads import RoadEnd
from scjax.data.readers.xml_elements import Element


class Connection(NamedTuple):
    """A way from a road into another one.

    Attributes:
      junction: id of the junction.
      incoming, connecting: ids of the roads; in a direct junction ``connecting`` is the road beyond.
      contact: the end of ``connecting`` that touches ``incoming``.
      lane_links: pairs of lane ids on the two roads.
    """

    junction: str
    incoming: str
    connecting: str
    contact: RoadEnd
    lane_links: tuple[tuple[int, int], ...]


def read_connections(junction: Element) -> list[Connection]:
    """The connections of a <junction>; virtual junctions and crossings have none that end roads.

    Raises:
      ValueError: something is missing or no number; says where.
    """
    if junction.text("type", "default") in ("virtual", "crossing"):
        return []
    connections = []
    for element in junction.all("connection"):
        road = element.attributes.get("connectingRoad", element.attributes.get("linkedRoad"))
        if road is None or "incomingRoad" not in element.attributes:
            continue  # virtual connections name lanes elsewhere
        contact = element.text("contactPoint", "start")
        if contact not in ("start", "end"):
            raise element.fault(f"contactPoint is {contact[:40]!r}, neither start nor end")
        pairs = tuple((link.whole("from"), link.whole("to")) for link in element.all("laneLink"))
        identity = junction.text("id")
        connections.append(Connection(identity, element.text("incomingRoad"), road.strip(), contact, pairs))
    return connections
