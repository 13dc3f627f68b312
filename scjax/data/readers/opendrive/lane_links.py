"""Which lanes follow which: across lane sections, roads and junctions."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from scjax.data.readers.opendrive.junctions import Connection
from scjax.data.readers.opendrive.lane_lines import LaneKey, LaneLine
from scjax.data.readers.opendrive.roads import MapRoad, RoadEnd, RoadLink

Links = set[tuple[LaneKey, LaneKey]]


class LaneLinks:
    """Collects the pairs of lanes that follow each other.

    A file whose lanes have no links at all means that lanes of one id follow each other.

    Attributes:
      pairs: (a, b), traffic drives from lane a into lane b.
      notes: what was left out of lanes for cars -> how often.

    Args:
      is_for_cars: whether cars drive on a lane.
    """

    def __init__(
        self,
        roads: Mapping[str, MapRoad],
        lines: Mapping[LaneKey, LaneLine],
        is_for_cars: Callable[[LaneLine], bool],
    ):
        self.pairs: Links = set()
        self.notes: Counter[str] = Counter()
        self._roads, self._lines, self._is_for_cars = roads, lines, is_for_cars
        lanes = [line.lane for line in lines.values()]
        self._same_ids = not any(lane.predecessor or lane.successor for lane in lanes)

    def add_sections(self, road: MapRoad) -> None:
        """Links lanes of sections in a row."""
        for sections in road.sides:
            for k, (section, following) in enumerate(itertools.pairwise(sections)):
                linked = [(lane.id, other) for lane in section.lanes for other in lane.successor]
                linked += [(other, lane.id) for lane in following.lanes for other in lane.predecessor]
                if self._same_ids:
                    linked = [(lane.id, lane.id) for lane in section.lanes]
                for lane_id, other in set(linked):
                    self._meet(LaneKey(road.id, k, lane_id), "end", LaneKey(road.id, k + 1, other), "start")

    def add_road_links(self, road: MapRoad) -> None:
        """Links the lanes at both ends of a road to those of the roads that it names."""
        for end, link in _road_ends(road):
            if link is None or link.is_junction:
                continue
            if link.id not in self._roads:
                self.notes["links to missing roads, not read"] += 1
                continue
            for side in road.sides:
                for lane in side[0 if end == "start" else -1].lanes if side else ():
                    named = lane.predecessor if end == "start" else lane.successor
                    if self._same_ids:
                        named = (lane.id if end != link.contact else -lane.id,)
                    for other in named:
                        near = self._at_end(road, lane.id, end)
                        self._meet(near, end, self._at_end(self._roads[link.id], other, link.contact), link.contact)

    def add_connections(self, connections: Iterable[Connection]) -> None:
        """Links the lanes of incoming roads to those of connecting roads."""
        for connection in connections:
            incoming, connecting = (self._roads.get(name) for name in (connection.incoming, connection.connecting))
            if incoming is None or connecting is None:
                self.notes["links to missing roads, not read"] += 1
                continue
            for lane_id, other in connection.lane_links:
                far = self._at_end(connecting, other, connection.contact)
                ends = self._ends_at(incoming, connecting, connection)
                near = {end: self._at_end(incoming, lane_id, end) for end in ends}
                end = min(ends, key=lambda end: self._gap(near[end], end, far, connection.contact))
                self._meet(near[end], end, far, connection.contact)

    def _ends_at(self, incoming: MapRoad, connecting: MapRoad, connection: Connection) -> list[RoadEnd]:
        """The ends of an incoming road that may touch a connecting road."""
        link = connecting.predecessor if connection.contact == "start" else connecting.successor
        if link is not None and not link.is_junction and link.id == incoming.id:
            return [link.contact]
        named: list[RoadEnd] = [
            end
            for end, link in _road_ends(incoming)
            if link is not None and link.is_junction and link.id == connection.junction
        ]
        return named or ["start", "end"]

    def _at_end(self, road: MapRoad, lane_id: int, end: RoadEnd) -> LaneKey:
        """A lane in the first or last section of a road."""
        return LaneKey(road.id, 0 if end == "start" else len(road.side(lane_id)) - 1, lane_id)

    def _gap(self, a: LaneKey, a_end: RoadEnd, b: LaneKey, b_end: RoadEnd) -> float:
        """Distance between two ends [m]; infinite if a lane does not exist."""
        if a not in self._lines or b not in self._lines:
            return float("inf")
        here, there = self._point(a, a_end), self._point(b, b_end)
        return float(np.hypot(*(here - there)[:2]))

    def _point(self, key: LaneKey, end: RoadEnd) -> np.ndarray:
        line = self._lines[key]
        return line.points[0 if (end == "start") == line.lane.forward else -1]

    def _meet(self, a: LaneKey, a_end: RoadEnd, b: LaneKey, b_end: RoadEnd) -> None:
        """Notes that two lanes touch there; the driving directions say which one follows the other."""
        lines = [self._lines[key] for key in (a, b) if key in self._lines]
        if len(lines) == 2:
            arrives = [line.lane.forward == (end == "end") for line, end in zip(lines, (a_end, b_end), strict=True)]
            if arrives[0] != arrives[1]:
                self.pairs.add((a, b) if arrives[0] else (b, a))
                return
        if lines and all(map(self._is_for_cars, lines)):
            fault = "between lanes that drive towards each other" if len(lines) == 2 else "to missing lanes"
            self.notes[f"links {fault}, not read"] += 1


def _road_ends(road: MapRoad) -> tuple[tuple[RoadEnd, RoadLink | None], tuple[RoadEnd, RoadLink | None]]:
    return ("start", road.predecessor), ("end", road.successor)
