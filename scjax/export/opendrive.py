"""OpenDRIVE 1.7 (ASAM): roads of one lane, junctions, heights and traffic lights; no traffic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from scjax.export.base import Export, Losses
from scjax.export.crossings import lane_crossings
from scjax.export.cut_forks import join_cut_forks
from scjax.export.lane_curves import LaneCurve, curve_line, fit_curve, piece_length
from scjax.export.lane_network import LaneNetwork, lane_network
from scjax.export.lane_nodes import lane_nodes, meeting_lines
from scjax.export.lane_widths import road_widths
from scjax.export.planned_road import PlannedRoad
from scjax.export.road_plan import plan_roads
from scjax.export.traffic import LANE_WIDTH
from scjax.export.xml_text import XmlElement, add_element, write_xml
from scjax.scene import Log

_LANE_TYPES = {"bike_lane": "biking", "bus_lane": "bus", "not_for_cars": "restricted", "undefined": "restricted"}
_LIGHT = "1000001"  # three lamps, in the standard's own catalog
_SAME_SLOPE = 1e-6
_SAME_HEIGHT = 1e-6  # m
_CHORD, _LEVEL_FACTOR = 2.0, 2.0  # m between points that netconvert puts on a curve; share of what they miss
_LIGHT_HEIGHT = 5.0  # m above the road


class PlacedSignal(NamedTuple):
    """A traffic light on a road.

    Attributes:
      name: "signal" and the number of the signal in the log; a second one has a letter.
      row: index of the signal in the log.
      s: arc length on the road [m].
    """

    name: str
    row: int
    s: float


class OpenDriveRoads(NamedTuple):
    """What an OpenDRIVE file holds of a log.

    Attributes:
      lanes: lanes of the log.
      roads: made of them.
      signals: of each road.
    """

    lanes: LaneNetwork
    roads: list[PlannedRoad]
    signals: dict[int, list[PlacedSignal]]


def write_opendrive(log: Log, path: Path, losses: Losses) -> tuple[Path, ...]:
    """Writes the map of ``log``.

    Raises:
      ValueError: the log has no lane.
    """
    losses["objects, left out"] += log.num_objects
    losses["signals whose states over time are left out"] += len(log.signal_lane_ids)
    write_xml(opendrive_tree(road_network(log, losses), log.metadata.scene_id or path.stem), path)
    return (path,)


def road_network(log: Log, losses: Losses) -> OpenDriveRoads:
    """The roads and traffic lights for the map of a log.

    Raises:
      ValueError: the log has no lane.
    """
    lanes = lane_network(log, losses)
    losses["pairs of lanes side by side, of which each is a road of its own"] += sum(map(len, lanes.left))
    losses['lanes of type "undefined", written as not for cars'] += sum(
        lane.lane_type == "undefined" for lane in lanes.lanes
    )
    lanes = join_cut_forks(lanes, losses)
    nodes = lane_nodes(lanes, losses)
    lines, headings = meeting_lines(lanes, nodes)
    curves = [fit_curve(line, float(a), float(b)) for line, (a, b) in zip(lines, headings, strict=True)]
    lit = {row for row, lane in enumerate(lanes.lanes) if lane.id in log.signal_lane_ids}
    kinds = [lane.lane_type for lane in lanes.lanes]
    roads = plan_roads(curves, nodes, lane_crossings(curves), kinds, lit)
    return OpenDriveRoads(lanes, roads, _signals(log, lanes, roads, losses))


def _signals(log: Log, lanes: LaneNetwork, roads: list[PlannedRoad], losses: Losses) -> dict[int, list[PlacedSignal]]:
    """Lights on the roads of the lanes that they control: in a junction where the lane enters one."""
    rows = {lane.id: row for row, lane in enumerate(lanes.lanes)}
    signals: dict[int, list[PlacedSignal]] = {}
    for row, lane in enumerate(log.signal_lane_ids):
        if lane not in rows:
            losses["signals of lanes that are not there, left out"] += 1
            continue
        places = _lit_places(rows[lane], roads)
        losses["signals of lanes that no lane leads to, left out"] += not places
        for number, (road, s) in enumerate(places):
            name = f"signal-{row}" + (f"-{number + 1}" if number else "")
            signals.setdefault(road, []).append(PlacedSignal(name, row, s))
    return signals


def _lit_places(lane: int, roads: Sequence[PlannedRoad]) -> list[tuple[int, float]]:
    """(road, arc length on it) of the lights of a lane: where it begins, or at the ends of what leads to it.

    The latter is for lanes that lead nowhere: a light on their roads would control no way.
    """
    own = [road for road in roads if road.lane == lane]
    if not own:  # a short lane between a fork and a merge, a part of the ways there
        return []
    first = min((road.start for road in own if road.junction), default=None)
    if first is not None:
        return [(road.id, 0.0) for road in own if road.junction and road.start == first]
    if own[0].after or own[0].junction_after:
        return [(own[0].id, 0.0)]
    return [(road.id, road.curve.length) for road in roads if road.after == own[0].id]


def opendrive_tree(network: OpenDriveRoads, name: str) -> XmlElement:
    """The <OpenDRIVE> element."""
    root = ElementTree.Element("OpenDRIVE")
    corners = np.concatenate([road.curve.pieces.reshape(-1, 2) for road in network.roads])
    (west, south), (east, north) = corners.min(0).tolist(), corners.max(0).tolist()
    header = {"revMajor": 1, "revMinor": 7, "name": name, "version": "1.00", "vendor": "scjax"}
    add_element(root, "header", **header, north=north, south=south, east=east, west=west)
    for road, (first, last) in zip(network.roads, road_widths(network.roads).tolist(), strict=True):
        _add_road(root, road, (first, last), network)
    for junction in sorted({road.junction for road in network.roads} - {0}):
        element = add_element(root, "junction", id=_junction_id(network, junction), name=f"junction {junction}")
        ways = [road for road in network.roads if road.junction == junction]
        for number, road in enumerate(ways):
            connection = add_element(
                element,
                "connection",
                id=number,
                incomingRoad=road.before,
                connectingRoad=road.id,
                contactPoint="start",
            )
            add_element(connection, "laneLink", **{"from": -1, "to": -1})
    return root


def _junction_id(network: OpenDriveRoads, junction: int) -> int:
    """Ids of junctions begin after those of roads."""
    return len(network.roads) + junction


def _add_road(root: XmlElement, road: PlannedRoad, widths: tuple[float, float], network: OpenDriveRoads) -> None:
    lane = network.lanes.lanes[road.lane]
    pieces = list(road.curve.pieces)
    lengths = [piece_length(piece) for piece in pieces]
    junction = _junction_id(network, road.junction) if road.junction else -1
    length = float(np.sum(lengths))
    element = add_element(
        root, "road", name=_road_name(network, road), length=length, id=road.id, junction=junction, rule="RHT"
    )
    links = add_element(element, "link")
    ends = (
        ("predecessor", road.before, road.junction_before, "end"),
        ("successor", road.after, road.junction_after, "start"),
    )
    for tag, other, junction_there, contact in ends:
        if other:
            add_element(links, tag, elementType="road", elementId=other, contactPoint=contact)
        elif junction_there:
            add_element(links, tag, elementType="junction", elementId=_junction_id(network, junction_there))
    add_element(element, "type", s=0.0, type="motorway" if lane.lane_type == "freeway" else "town")
    plan = add_element(element, "planView")
    for piece, start, size in zip(pieces, np.cumsum([0.0, *lengths[:-1]]).tolist(), lengths, strict=True):
        _add_geometry(plan, piece, start, size)
    _add_heights(element, road.curve)
    slope = (widths[1] - widths[0]) / length
    _add_lane(element, road, _LANE_TYPES.get(lane.lane_type or "", "driving"), widths[0], slope)
    if road.id in network.signals:
        _add_signals(add_element(element, "signals"), network.signals[road.id])


def _add_signals(group: XmlElement, signals: Sequence[PlacedSignal]) -> None:
    for signal in signals:
        light = add_element(
            group,
            "signal",
            **{"s": signal.s, "t": -LANE_WIDTH, "id": signal.name, "name": signal.name, "dynamic": "yes"},
            **{"orientation": "+", "zOffset": _LIGHT_HEIGHT, "country": "OpenDRIVE", "type": _LIGHT, "subtype": "-1"},
            **{"value": -1.0, "width": 0.3, "height": 0.9, "hOffset": 0.0},
        )
        add_element(light, "validity", fromLane=-1, toLane=-1)


def _road_name(network: OpenDriveRoads, road: PlannedRoad) -> str:
    """The ids of the lanes of a road; of a way through a junction that of the lane that it leads to."""
    return "+".join(network.lanes.lanes[row].id for row in ((road.lane,) if road.junction else road.lanes))


def _add_geometry(plan: XmlElement, piece: np.ndarray, start: float, length: float) -> None:
    """A <geometry> with the polynomials of a piece in the frame of its start."""
    step = piece[1] - piece[0]
    heading = float(np.arctan2(step[1], step[0]))
    cos, sin = np.cos(heading), np.sin(heading)
    local = (piece - piece[0]) @ np.array([[cos, -sin], [sin, cos]])
    b = 3 * (local[1] - local[0])
    c = 3 * (local[2] - 2 * local[1] + local[0])
    d = local[3] - 3 * local[2] + 3 * local[1] - local[0]
    geometry = add_element(
        plan, "geometry", s=start, x=float(piece[0, 0]), y=float(piece[0, 1]), hdg=heading, length=length
    )
    names = [f"{letter}{axis}" for axis in "UV" for letter in "abcd"]
    values = [0.0, float(b[0]), float(c[0]), float(d[0]), 0.0, 0.0, float(c[1]), float(d[1])]
    add_element(geometry, "paramPoly3", **dict(zip(names, values, strict=True)), pRange="normalized")


def _add_heights(element: XmlElement, curve: LaneCurve) -> None:
    """The heights; the last bit is level, so that programs that measure along chords end at the same height."""
    table = curve.heights
    end, top = table[-1].tolist()
    level = max(end - _LEVEL_FACTOR * _chord_deficit(curve), end / 2)
    place = float(np.interp(level, *table.T))
    if abs(place - top) > _SAME_HEIGHT:
        inner = table[:, 0] < level - _SAME_HEIGHT
        table = np.concatenate([table[inner], [[level, top], [end, top]]])
    profile = add_element(element, "elevationProfile")
    before = None
    for (s, z), (end, top) in zip(table[:-1].tolist(), table[1:].tolist(), strict=True):
        slope = (top - z) / max(end - s, 1e-9)
        if before is not None and abs(slope - before) < _SAME_SLOPE:
            continue  # the record before goes on
        before = slope
        add_element(profile, "elevation", s=s, a=z, b=slope, c=0.0, d=0.0)


def _chord_deficit(curve: LaneCurve) -> float:
    """How much shorter a polyline with points every 2 m is than the curve [m]."""
    points, arc = curve_line(curve, _CHORD)
    return float(arc[-1] - np.hypot(*np.diff(points[:, :2], axis=0).T).sum())


def _add_lane(element: XmlElement, road: PlannedRoad, kind: str, width: float, slope: float) -> None:
    """The lane of the road, with its middle on the reference line.

    Args:
      width, slope: at the start [m], and its change for each meter.
    """
    lanes = add_element(element, "lanes")
    add_element(lanes, "laneOffset", s=0.0, a=width / 2, b=slope / 2, c=0.0, d=0.0)
    section = add_element(lanes, "laneSection", s=0.0)
    middle = add_element(add_element(section, "center"), "lane", id=0, type="none", level="false")
    add_element(middle, "link")
    lane = add_element(add_element(section, "right"), "lane", id=-1, type=kind, level="false")
    links = add_element(lane, "link")
    if road.before:
        add_element(links, "predecessor", id=-1)
    if road.after:
        add_element(links, "successor", id=-1)
    add_element(lane, "width", sOffset=0.0, a=width, b=slope, c=0.0, d=0.0)


OPENDRIVE_EXPORT = Export("OpenDRIVE", ".xodr", "SUMO, esmini, CARLA, RoadRunner", write_opendrive)
