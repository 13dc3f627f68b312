"""The form of OpenDRIVE files that consumers accept, checked without them."""

from __future__ import annotations

import dataclasses
import itertools
from xml.etree import ElementTree

import numpy as np
import pytest

from scjax.export import export_log
from scjax.export.base import Losses
from scjax.export.opendrive import road_network
from scjax.export.roads.lane_curves import curve_frames, curve_line
from scjax.export.roads.lane_widths import all_lane_borders
from scjax.export.roads.planned_road import PlannedRoad
from scjax.export.roads.road_chains import join_chains
from scjax.export.roads.wide_road import lane_ends
from scjax.scene import MapLane
from scjax.synthetic.recording import to_log
from scjax.synthetic.world import make_world
from tests.factories.exports import crossing_log, mixed_node_log, two_lane_log
from tests.factories.logs import example_log

MAKERS = {
    "crossing": crossing_log,
    "two lanes": two_lane_log,
    "example": example_log,
    "mixed node": mixed_node_log,
    "part of a mixed node": lambda: mixed_node_log(False),
    "town": lambda: to_log(make_world(5, 7)),
    "motorway": lambda: to_log(make_world(5, 1)),
}


@pytest.fixture(scope="module", params=list(MAKERS))
def roads(request):
    return road_network(MAKERS[request.param](), Losses()).roads


def _lane_end(road, row: int, at_end: bool, borders) -> tuple[np.ndarray, float, float]:
    """Place, direction [rad] and width [m] of a lane's traffic at an end of its road."""
    station = road.curve.length if at_end else 0.0
    (place,), (heading,) = curve_frames(road.curve, np.array([station]))
    table = borders[road.id]
    left, right = table.offsets[-1 if at_end else 0, row : row + 2]
    slope = table.slopes[-1 if at_end else 0, row : row + 2].mean()
    place = place + (left + right) / 2 * np.array([-np.sin(heading), np.cos(heading)])
    turn = np.arctan(slope) + (np.pi if road.lanes[row].number > 0 else 0.0)
    return np.append(place, road.curve.heights[-1 if at_end else 0, 1]), float(heading + turn), float(left - right)


def test_ways_through_junctions_lead_from_lane_to_lane(roads):
    borders, places = all_lane_borders(roads), lane_ends(roads)
    by_id = {road.id: road for road in roads}
    for way in roads:
        if not way.junction:
            continue
        (lane,) = way.lanes
        for place, at_end in ((places[lane.road.before].last, False), (places[lane.road.after].first, True)):
            road = by_id[place.road]
            assert not road.junction
            assert (road.junction_after if place.at_end else road.junction_before) == way.junction
            row = [lane.number for lane in road.lanes].index(place.number)
            ours, theirs = _lane_end(way, 0, at_end, borders), _lane_end(road, row, place.at_end, borders)
            np.testing.assert_allclose(ours[0], theirs[0], atol=2e-3)
            assert abs(np.angle(np.exp(1j * (ours[1] - theirs[1])))) < 0.01
            assert ours[2] == pytest.approx(theirs[2], abs=1e-6)


def test_roads_that_follow_each_other_meet(roads):
    by_id = {road.id: road for road in roads}
    for road in roads:
        assert not (road.after and road.junction_after) and not (road.before and road.junction_before)
        if road.after:
            following = by_id[road.after]
            assert following.before == road.id
            assert [lane.number for lane in following.lanes] == [lane.number for lane in road.lanes]
            ends = [curve_line(road.curve)[0][[-2, -1]], curve_line(following.curve)[0][[0, 1]]]
            np.testing.assert_allclose(ends[0][1], ends[1][0], atol=1e-3)
            directions = [np.diff(end[:, :2], axis=0)[0] for end in ends]
            units = [direction / np.hypot(*direction) for direction in directions]
            assert units[0] @ units[1] > 0.9


def test_every_lane_at_a_junction_leads_into_it_or_out_of_it(roads):
    places = lane_ends(roads)
    for road in roads:
        for lane in road.lanes:
            if road.junction:
                continue
            enters = road.junction_after if lane.number < 0 else road.junction_before
            if enters and places[lane.road.id].last.road == road.id:
                ways = [way for way in roads if way.junction and way.lanes[0].road.before == lane.road.id]
                assert ways and {way.junction for way in ways} == {enters}


def test_no_two_roads_lead_from_a_junction_to_the_same_one(roads):
    pairs = []
    for road in roads:
        ends = (road.junction_before, road.junction_after)
        if all(ends):
            pairs += {ends if lane.number < 0 else ends[::-1] for lane in road.lanes}
    assert len(set(pairs)) == len(pairs) and all(a != b for a, b in pairs)


def test_lanes_of_one_type_in_a_row_are_one_road(tmp_path):
    line = two_lane_log().lanes[1].points
    rows = {"a": ("freeway", 0, 20), "b": ("freeway", 20, 35), "c": ("bike_lane", 35, 50)}
    lanes = tuple(
        MapLane(name, kind, line[i : j + 1], *((other,) if other in rows else () for other in map(chr, beside)))
        for (name, (kind, i, j)), beside in zip(rows.items(), ((0, 98), (97, 99), (98, 0)), strict=True)
    )
    log = dataclasses.replace(two_lane_log(), lanes=lanes)
    first, second = road_network(log, Losses()).roads
    assert [road.lanes[0].road.lanes for road in (first, second)] == [(0, 1), (2,)]
    assert first.after == second.id and second.before == first.id
    path = export_log(log, tmp_path / "map.xodr", "opendrive").paths[0]
    assert [road.get("name") for road in ElementTree.parse(path).getroot().iter("road")] == ["a+b", "c"]


def test_ring_of_roads_stays_as_it_is():
    curve = road_network(two_lane_log(), Losses()).roads[0].curve
    ring = [PlannedRoad(k + 1, curve, k, 0.0, (k,), 0, (k - 1) % 3 + 1, (k + 1) % 3 + 1) for k in range(3)]
    assert [(road.before, road.after) for road in join_chains(ring, [None] * 3)] == [(3, 2), (1, 3), (2, 1)]


def test_bent_road_is_level_at_its_end(tmp_path):
    path = export_log(two_lane_log(), tmp_path / "map.xodr", "opendrive").paths[0]
    for road in ElementTree.parse(path).getroot().iter("road"):
        *_, before, last = road.findall("elevationProfile/elevation")
        assert float(last.get("a")) == pytest.approx(5.0, abs=1e-3) and float(last.get("b")) == 0.0
        assert float(before.get("b")) > 0
        assert 0 < float(road.get("length")) - float(last.get("s")) < 0.2


def test_lanes_that_cross_share_a_junction():
    network = road_network(crossing_log(), Losses())
    names = {lane.id: row for row, lane in enumerate(network.lanes.lanes)}
    junctions = {
        name: {road.junction for road in network.roads if road.lanes[0].road.lane == names[name]} - {0}
        for name in ("straight", "across")
    }
    assert junctions["straight"] & junctions["across"]


def test_bridge_shares_no_junction_with_the_road_below():
    log = crossing_log()
    for lane in log.lanes:
        if lane.id == "across":
            lane.points[:, 2] += 6.0
    network = road_network(log, Losses())
    across = [road for road in network.roads if network.lanes.lanes[road.lanes[0].road.lane].id == "across"]
    assert [road.junction for road in across] == [0]


@pytest.mark.parametrize("make", MAKERS)
def test_file_has_what_the_schema_asks_for(make, tmp_path):
    path = export_log(MAKERS[make](), tmp_path / "map.xodr", "opendrive").paths[0]
    root = ElementTree.parse(path).getroot()
    assert root.find("header").attrib.keys() >= {"north", "south", "east", "west", "revMajor", "revMinor"}
    order = ["link", "type", "planView", "elevationProfile", "lanes", "signals"]
    for road in root.iter("road"):
        tags = [child.tag for child in road]
        assert tags == [tag for tag in order if tag in tags] and len(road.find("elevationProfile"))
        pieces = road.findall("planView/geometry")
        starts = np.array([float(piece.get("s")) for piece in pieces] + [float(road.get("length"))])
        np.testing.assert_allclose(np.diff(starts), [float(piece.get("length")) for piece in pieces])
        profile = [float(record.get("s")) for record in road.findall("elevationProfile/elevation")]
        assert profile[0] == 0.0 and (np.diff(profile) > 0).all()
    ids = [element.get("id") for element in itertools.chain(root.iter("road"), root.iter("junction"))]
    assert len(set(ids)) == len(ids)


def test_signal_stands_in_the_junction_of_its_lane(tmp_path):
    path = export_log(crossing_log(), tmp_path / "map.xodr", "opendrive").paths[0]
    root = ElementTree.parse(path).getroot()
    (road,) = [road for road in root.iter("road") if road.find("signals") is not None]
    assert road.get("name") == "straight" and road.get("junction") != "-1"


def test_signal_of_a_lane_that_leads_nowhere_stands_where_lanes_lead_to_it():
    network = road_network(crossing_log(signal_lane_ids=("out",)), Losses())
    by_id = {road.id: road for road in network.roads}
    lit = [by_id[road] for road in network.signals]
    assert {network.lanes.lanes[road.lanes[0].road.lane].id for road in lit} == {"straight", "merge"}
    for road in lit:
        (lane,) = by_id[road.lanes[0].road.after].lanes
        assert network.lanes.lanes[lane.road.lane].id == "out"
        assert [signal.s for signal in network.signals[road.id]] == [road.curve.length]


def test_signal_of_a_lane_without_others_is_left_out_and_said():
    log, losses = crossing_log(), Losses()
    alone = dataclasses.replace(two_lane_log(), signal_lane_ids=("left",), signal_states=log.signal_states,
                                signal_positions=log.signal_positions)  # fmt: skip
    assert road_network(alone, losses).signals == {}
    assert losses["signals of lanes that no lane leads to, left out"] == 1
