"""Maps that nothing grows from, and maps with faults: what happens is defined, and the map stays valid."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import scjax
from scjax.data.map_joins import connect_lanes
from scjax.outpainting.outpaint import outpaint_steps
from scjax.outpainting.window import MAX_KNOWN, WindowPose, cut_window
from scjax.scene import Map, MapLane, TileStatus, save_map
from tests.factories.maps import map_lane, street_grid, two_tile_map

FEW = {"candidates": 2, "retries": 0, "max_tiles": 1}


def _with_lanes(*lanes: MapLane, **changes) -> Map:
    map = two_tile_map()
    return dataclasses.replace(map, lanes=(*map.lanes, *lanes), **changes)


def _contradicting() -> Map:
    """The road's end is listed as connected to a lane 400 m away."""
    map = _with_lanes(map_lane("far", (500, 500), (600, 500), predecessors=("ahead-1",)))
    lanes = (dataclasses.replace(lane, successors=("far",)) if lane.id == "ahead-1" else lane for lane in map.lanes)
    return dataclasses.replace(map, lanes=tuple(lanes))


def _crowded() -> Map:
    """Three vehicles in one place, behind the seam."""
    map = two_tile_map()
    agents = np.repeat(map.agents, 3, 0)
    agents[:, 0] = [90.0, 90.5, 91.0]
    tiles = tuple(dataclasses.replace(tile, agent_ids=()) for tile in map.tiles)
    types = np.repeat(map.agent_types, 3)
    return dataclasses.replace(map, agents=agents, agent_types=types, agent_ids=("a", "b", "c"), tiles=tiles)


@pytest.mark.parametrize(
    "map",
    [
        _with_lanes(
            MapLane(id="no length", lane_type=None, points=np.full((2, 3), 5.0)),
            MapLane(id="a point", lane_type=None, points=np.zeros((1, 3))),
        ),
        _with_lanes(map_lane("alone", (10, 20), (20, 25))),
        _contradicting(),
        _crowded(),
    ],
    ids=["lanes of no length", "a lane alone", "contradicting connections", "agents in each other"],
)
def test_maps_with_faults_grow_and_keep_what_they_have(map):
    grown = scjax.outpaint(0, map, length=200.0, **FEW)
    assert grown.tiles[-1].status != TileStatus.MISSING and len(grown.tiles) == 3
    assert {lane.id for lane in map.lanes} <= {lane.id for lane in grown.lanes}
    assert grown.agent_ids[: map.num_agents] == map.agent_ids
    assert np.array_equal(grown.agents[: map.num_agents], map.agents, equal_nan=True)


def test_connections_that_contradict_the_geometry_do_not_count():
    lanes = connect_lanes(_contradicting()).lane_by_id
    assert lanes["ahead-1"].successors == () and lanes["ahead-0"].successors == ("ahead-1",)


def test_maps_without_recorded_connections_are_connected_where_lanes_meet():
    map = two_tile_map()
    bare = tuple(dataclasses.replace(lane, predecessors=(), successors=()) for lane in map.lanes)
    lanes = connect_lanes(dataclasses.replace(map, lanes=bare, has_topology=False)).lane_by_id
    assert {name: lane.successors for name, lane in lanes.items()} == {
        name: lane.successors for name, lane in map.lane_by_id.items()
    }


@pytest.fixture
def ring():
    """A circle of 50 m, without a way out."""
    points = [(50 * np.cos(angle), 50 * np.sin(angle)) for angle in np.linspace(0, 2 * np.pi, 60)]
    return Map(lanes=(map_lane("ring", *points, predecessors=("ring",), successors=("ring",)),))


def test_a_map_without_a_way_out_stays_as_it_is(ring):
    (only,) = outpaint_steps(0, ring, at=(50.0, 0.0, np.pi / 2), **FEW)
    assert only.lanes == ring.lanes and not only.tiles


def test_the_command_says_when_no_road_goes_on(run, tmp_path, ring):
    save_map(ring, tmp_path / "ring.json")
    code, _, err = run("outpaint", "--start", "ring.json", "--at", "50,0,90", "--length", "50")
    assert code == 0 and "the route is 0 m long: no road goes on from there" in err


def test_a_route_that_leaves_the_map_is_followed_as_far_as_roads_go():
    grown = scjax.outpaint(0, two_tile_map(), length=200.0, route=[(0.0, 0.0), (-5000.0, 5000.0)], **FEW)
    assert len(grown.tiles) == 3


def test_more_lanes_than_the_network_knows_are_cut_to_the_nearest():
    lanes = tuple(map_lane(f"lane {row}", (-32, row - 55), (96, row - 55)) for row in range(110))
    scene = cut_window(Map(lanes=lanes), WindowPose(95.5, 0.0, 0.0, 0.0))
    assert 0 < scene.num_lanes <= MAX_KNOWN[1] and np.abs(np.asarray(scene.lanes)[..., 1]).max() <= 32.0


def test_large_maps_grow_at_one_place():
    """5 km x 5 km of streets, 10,200 lanes."""
    map = street_grid(5000.0)
    grown = scjax.outpaint(0, map, area=(4900.0, 5100.0, 4900.0, 5100.0), at=(0.0, -2.0, 0.0), **FEW)
    assert len(grown.tiles) == 1 and grown.num_lanes >= map.num_lanes
