"""OpenDRIVE 1.7 (ASAM): roads, junctions, heights and traffic lights; no traffic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from scjax.export.base import Export, Losses
from scjax.export.opendrive_lanes import add_lanes
from scjax.export.roads.crossings import lane_crossings
from scjax.export.roads.cut_forks import join_cut_forks
from scjax.export.roads.lane_borders import LaneBorders
from scjax.export.roads.lane_curves import LaneCurve, curve_line, fit_curve, piece_length
from scjax.export.roads.lane_network import LaneNetwork, lane_network
from scjax.export.roads.lane_nodes import lane_nodes, meeting_lines
from scjax.export.roads.lane_widths import all_lane_borders
from scjax.export.roads.mixed_nodes import split_mixed_nodes
from scjax.export.roads.planned_road import PlannedRoad
from scjax.export.roads.road_plan import plan_roads
from scjax.export.roads.wide_road import LaneEnd, LaneEnds, WideRoad, lane_ends
from scjax.export.roads.wide_roads import wide_roads
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
      lane: number of the lane on the road.
      s: arc length on the road [m].
    """

    name: str
    row: int
    lane: int
    s: float


class OpenDriveRoads(NamedTuple):
    """What an OpenDRIVE file holds of a log.

    Attributes:
      lanes: lanes of the log.
      roads: made of them.
      signals: of each road, by its id.
    """

    lanes: LaneNetwork
    roads: list[WideRoad]
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
    losses['lanes of type "undefined", written as not for cars'] += sum(
        lane.lane_type == "undefined" for lane in lanes.lanes
    )
    lanes = split_mixed_nodes(join_cut_forks(lanes, losses), losses)
    nodes = lane_nodes(lanes, losses)
    lines, headings = meeting_lines(lanes, nodes)
    curves = [fit_curve(line, float(a), float(b)) for line, (a, b) in zip(lines, headings, strict=True)]
    lit = {row for row, lane in enumerate(lanes.lanes) if lane.id in log.signal_lane_ids}
    kinds = [lane.lane_type for lane in lanes.lanes]
    roads = wide_roads(plan_roads(curves, nodes, lane_crossings(curves), kinds, lit), kinds)
    together = {(a, b) for road in roads for a in _lanes_of(road) for b in _lanes_of(road)}
    apart = [(i, beside.lane) for i, row in enumerate(lanes.left) for beside in row if (i, beside.lane) not in together]
    losses["pairs of lanes side by side that are lanes of two roads"] += len(apart)
    return OpenDriveRoads(lanes, roads, _signals(log, lanes, roads, losses))


def _lanes_of(road: WideRoad) -> set[int]:
    """Indices of the lanes that run along a road."""
    return {row for lane in road.lanes for row in lane.road.lanes}


def _signals(log: Log, lanes: LaneNetwork, roads: list[WideRoad], losses: Losses) -> dict[int, list[PlacedSignal]]:
    """Lights on the roads of the lanes that they control: in a junction where the lane enters one."""
    rows = {lane.id: row for row, lane in enumerate(lanes.lanes)}
    planned = {lane.road.id: lane.road for road in roads for lane in road.lanes}
    ends_of, by_id = lane_ends(roads), {road.id: road for road in roads}
    signals: dict[int, list[PlacedSignal]] = {}
    for row, lane in enumerate(log.signal_lane_ids):
        if lane not in rows:
            losses["signals of lanes that are not there, left out"] += 1
            continue
        lit = _lit_ends(rows[lane], list(planned.values()))
        losses["signals of lanes that no lane leads to, left out"] += not lit
        for number, (id, is_last) in enumerate(lit):
            end = ends_of[id].last if is_last else ends_of[id].first
            name = f"signal-{row}" + (f"-{number + 1}" if number else "")
            s = by_id[end.road].curve.length if end.at_end else 0.0
            signals.setdefault(end.road, []).append(PlacedSignal(name, row, end.number, s))
    return signals


def _lit_ends(lane: int, roads: Sequence[PlannedRoad]) -> list[tuple[int, bool]]:
    """(road, whether at its end) of the lights of a lane: where it begins, or at the ends of what leads to it.

    The latter is for lanes that lead nowhere: a light on their roads would control no way.
    """
    own = [road for road in roads if road.lane == lane]
    if not own:  # a short lane between a fork and a merge, a part of the ways there
        return []
    first = min((road.start for road in own if road.junction), default=None)
    if first is not None:
        return [(road.id, False) for road in own if road.junction and road.start == first]
    if own[0].after or own[0].junction_after:
        return [(own[0].id, False)]
    return [(road.id, True) for road in roads if road.after == own[0].id]


def opendrive_tree(network: OpenDriveRoads, name: str) -> XmlElement:
    """The <OpenDRIVE> element."""
    root = ElementTree.Element("OpenDRIVE")
    corners = np.concatenate([road.curve.pieces.reshape(-1, 2) for road in network.roads])
    (west, south), (east, north) = corners.min(0).tolist(), corners.max(0).tolist()
    header = {"revMajor": 1, "revMinor": 7, "name": name, "version": "1.00", "vendor": "scjax"}
    add_element(root, "header", **header, north=north, south=south, east=east, west=west)
    borders, ends_of = all_lane_borders(network.roads), lane_ends(network.roads)
    for road in network.roads:
        _add_road(root, road, borders[road.id], ends_of, network)
    for junction in sorted({road.junction for road in network.roads} - {0}):
        element = add_element(root, "junction", id=_junction_id(network, junction), name=f"junction {junction}")
        ways = [road for road in network.roads if road.junction == junction]
        for number, road in enumerate(ways):
            end = ends_of[road.lanes[0].road.before].last
            connection = add_element(
                element,
                "connection",
                id=number,
                incomingRoad=end.road,
                connectingRoad=road.id,
                contactPoint="start",
            )
            add_element(connection, "laneLink", **{"from": end.number, "to": road.lanes[0].number})
    return root


def _junction_id(network: OpenDriveRoads, junction: int) -> int:
    """Ids of junctions begin after those of roads."""
    return max(road.id for road in network.roads) + junction


def _add_road(
    root: XmlElement,
    road: WideRoad,
    borders: LaneBorders,
    ends_of: dict[int, LaneEnds],
    network: OpenDriveRoads,
) -> None:
    lane = network.lanes.lanes[road.lanes[0].road.lane]
    pieces = list(road.curve.pieces)
    lengths = [piece_length(piece) for piece in pieces]
    junction = _junction_id(network, road.junction) if road.junction else -1
    length = float(np.sum(lengths))
    element = add_element(
        root, "road", name=_road_name(network, road), length=length, id=road.id, junction=junction, rule="RHT"
    )
    links = add_element(element, "link")
    linked = _linked_lanes(road, ends_of)
    numbers = (road.junction_before, road.junction_after)
    for tag, ends, number in zip(("predecessor", "successor"), linked, numbers, strict=True):
        if ends:
            contact = "end" if ends[0].at_end else "start"
            add_element(links, tag, elementType="road", elementId=ends[0].road, contactPoint=contact)
        elif number:
            add_element(links, tag, elementType="junction", elementId=_junction_id(network, number))
    add_element(element, "type", s=0.0, type="motorway" if lane.lane_type == "freeway" else "town")
    plan = add_element(element, "planView")
    for piece, start, size in zip(pieces, np.cumsum([0.0, *lengths[:-1]]).tolist(), lengths, strict=True):
        _add_geometry(plan, piece, start, size)
    _add_heights(element, road.curve)
    kind = _LANE_TYPES.get(lane.lane_type or "", "driving")
    add_lanes(element, road, borders, kind, *([end.number for end in ends] for ends in linked))
    if road.id in network.signals:
        incoming = linked[0][0].number if road.junction else 0
        _add_signals(add_element(element, "signals"), road, borders, network.signals[road.id], incoming)


def _linked_lanes(road: WideRoad, ends_of: dict[int, LaneEnds]) -> tuple[Sequence[LaneEnd], Sequence[LaneEnd]]:
    """The lanes of roads that its lanes are linked to, before and after; none where a junction or nothing is."""
    if road.junction:
        way = road.lanes[0].road
        return [ends_of[way.before].last], [ends_of[way.after].first]
    before, after = (
        [LaneEnd(id, lane.number, id == road.before) for lane in road.lanes] if id else []
        for id in (road.before, road.after)
    )
    return before, after


def _add_signals(
    group: XmlElement, road: WideRoad, borders: LaneBorders, signals: Sequence[PlacedSignal], incoming: int
) -> None:
    """Lights at the outer borders of their lanes.

    Args:
      incoming: number of the lane that leads to a way through a junction. netconvert expects its sign in <validity>; a
        way has one lane, and needs none.
    """
    rows = {lane.number: row for row, lane in enumerate(road.lanes)}
    for signal in signals:
        row = rows[signal.lane] + (signal.lane < 0)
        t = float(borders.offsets[-1 if signal.s else 0, row])
        light = add_element(
            group,
            "signal",
            **{"s": signal.s, "t": t, "id": signal.name, "name": signal.name, "dynamic": "yes"},
            **{"orientation": "+" if signal.lane < 0 else "-", "zOffset": _LIGHT_HEIGHT, "country": "OpenDRIVE"},
            **{"type": _LIGHT, "subtype": "-1", "value": -1.0, "width": 0.3, "height": 0.9, "hOffset": 0.0},
        )
        if incoming <= 0:
            add_element(light, "validity", fromLane=signal.lane, toLane=signal.lane)


def _road_name(network: OpenDriveRoads, road: WideRoad) -> str:
    """The ids of the lanes of a road; of a way through a junction that of the lane that it leads to."""
    rows = [(lane.road.lane,) if road.junction else lane.road.lanes for lane in road.lanes]
    return " | ".join("+".join(network.lanes.lanes[row].id for row in lanes) for lanes in rows)


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


OPENDRIVE_EXPORT = Export("OpenDRIVE", ".xodr", "SUMO, esmini, CARLA, RoadRunner", write_opendrive)
