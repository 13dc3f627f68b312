"""A parsed OpenDRIVE file: its lanes as centerlines, how they follow each other, and which have a signal."""

from __future__ import annotations

import dataclasses
from collections import Counter, defaultdict

from scjax.data.readers.opendrive.junctions import read_connections
from scjax.data.readers.opendrive.lane_ends import close_gaps, join_forks
from scjax.data.readers.opendrive.lane_lines import MAX_POINTS, LaneKey, LaneLine, sample_section
from scjax.data.readers.opendrive.lane_links import LaneLinks
from scjax.data.readers.opendrive.lane_sections import cut_sections
from scjax.data.readers.opendrive.lane_signals import controlled_lanes, read_signals
from scjax.data.readers.opendrive.lane_types import LaneTypes
from scjax.data.readers.opendrive.roads import MapRoad, read_road
from scjax.data.readers.opendrive.tapers import join_tapers
from scjax.data.readers.xml_elements import Element


@dataclasses.dataclass(frozen=True)
class RoadMap:
    """The lanes of a map, of every type.

    Attributes:
      lines: centerlines by lane.
      lane_types: of each, as in ``MapLane``.
      successors, predecessors: lanes after and before each lane, in driving direction.
      signal_lanes: lanes that a traffic light controls.
      unknown_words: "lane type: word" -> how often; words that no table has.
      notes: what was not read -> how often.
    """

    lines: dict[LaneKey, LaneLine]
    lane_types: dict[LaneKey, str | None]
    successors: dict[LaneKey, list[LaneKey]]
    predecessors: dict[LaneKey, list[LaneKey]]
    signal_lanes: list[LaneKey]
    unknown_words: Counter[str]
    notes: Counter[str]


def build_road_map(root: Element) -> RoadMap:
    """The lanes of an <OpenDRIVE> element.

    Raises:
      ValueError: it is none, or something in it is missing, absurd or contradictory; says where.
    """
    if root.tag != "OpenDRIVE":
        raise ValueError(f"line {root.line}: the root is <{root.tag[:40]}>, not <OpenDRIVE>: give an OpenDRIVE file")
    roads = _read_roads(root)
    lines = _sample_roads(roads)
    types = LaneTypes()
    links = LaneLinks(roads, lines, types.is_for_cars)
    for road in roads.values():
        links.add_sections(road)
        links.add_road_links(road)
    for junction in root.all("junction"):
        links.add_connections(read_connections(junction))
    join_tapers(lines, links.pairs, types.is_for_cars)
    close_gaps(lines, links.pairs)
    join_forks(lines, links.pairs)
    successors, predecessors = defaultdict(list), defaultdict(list)
    for a, b in sorted(links.pairs):
        successors[a].append(b)
        predecessors[b].append(a)
    signals, notes = read_signals(roads)
    signal_lanes = controlled_lanes(signals, roads, lines, successors)
    lane_types = {key: types.of(line, key in successors or key in predecessors) for key, line in lines.items()}
    return RoadMap(
        lines, lane_types, dict(successors), dict(predecessors), signal_lanes, types.unknown_words, notes + links.notes
    )


def _read_roads(root: Element) -> dict[str, MapRoad]:
    roads: dict[str, MapRoad] = {}
    for element in root.all("road"):
        road = cut_sections(read_road(element))
        if road.id in roads:
            raise element.fault("another road has the same id")
        roads[road.id] = road
    if not roads:
        raise ValueError(f"line {root.line}, <OpenDRIVE>: has no <road>: give a file with a road network")
    return roads


def _sample_roads(roads: dict[str, MapRoad]) -> dict[LaneKey, LaneLine]:
    lines: dict[LaneKey, LaneLine] = {}
    total = 0
    for road in roads.values():
        for sections in road.sides:
            for index, section in enumerate(sections):
                for line in sample_section(road, index, section):
                    lines[line.key] = line
                    total += len(line.points)
        if total > MAX_POINTS:
            raise ValueError(f"its lanes need more than {MAX_POINTS} points: split the map")
    return lines
