"""Maps: invariants, forms, routes and seams."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.scene import (
    Map,
    MapRoute,
    Scene,
    TileStatus,
    find_route,
    join_maps,
    log_to_map,
    map_to_log,
    measure_seam,
    route_line,
    scene_to_map,
    validate_log,
    validate_map,
)
from scjax.scene.map import MapSeam, MapTile
from tests.factories.event_scenes import two_way_road
from tests.factories.logs import example_log
from tests.factories.maps import map_lane, two_tile_map


def test_validate_map_returns_valid_maps():
    map = two_tile_map()
    assert validate_map(map) is map
    assert map.extent == (-32.0, 96.0, -32.0, 32.0)
    assert validate_map(Map(lanes=())).extent == (0.0, 0.0, 0.0, 0.0)


def _changed_lane(**fields):
    map = two_tile_map()
    return {"lanes": (dataclasses.replace(map.lanes[0], **fields), *map.lanes[1:])}


def _changed_tile(**fields):
    map = two_tile_map()
    return {"tiles": (dataclasses.replace(map.tiles[0], **fields), map.tiles[1])}


def _changed_seam(**fields):
    return {"seams": (dataclasses.replace(two_tile_map().seams[0], **fields),)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (_changed_lane(points=np.zeros((0, 3))), "lane ahead-0 has points of shape"),
        (_changed_lane(points=np.full((2, 3), np.nan)), "lane ahead-0 has NaN or absurd"),
        (_changed_lane(id="back-0"), "lanes holds 'back-0' more than once"),
        (
            {"signal_states": np.zeros(2, np.int32), "signal_positions": np.zeros((2, 3))},
            "do not fit 1 signal_lane_ids",
        ),
        ({"agent_types": np.array([9], np.int32)}, "agent_types holds values outside 0..3"),
        ({"agents": np.zeros((1, 9))}, "not a unit vector"),
        ({"agents": np.full((1, 9), np.inf)}, "agents have NaN or absurd coordinates"),
        (_changed_tile(x=float("nan")), "the pose of tile 0"),
        (_changed_tile(attempts=-1), "tile 0 has -1 attempts"),
        (_changed_tile(lane_ids=("nowhere",)), "tile 0 names the lane 'nowhere'"),
        (_changed_tile(agent_ids=("nobody",)), "tile 0 names the agent 'nobody'"),
        (_changed_tile(lane_ids=("ahead-1",)), "more than once"),
        (_changed_seam(tiles=(0, 2)), r"names the tiles \(0, 2\) of 2"),
        (_changed_seam(start=(float("inf"), 0.0)), "the line of seam 0"),
        (_changed_seam(connections=(("ahead-0", "back-0"),)), "do not lie on both sides"),
        (_changed_seam(connections=(("ahead-0", "back-1"),)), "'back-1' does not follow 'ahead-0'"),
        ({"routes": (MapRoute(lane_ids=()),)}, "route 0 has no lanes"),
        ({"routes": (MapRoute(lane_ids=("nowhere",)),)}, "route 0 names the lane 'nowhere'"),
        ({"routes": (MapRoute(lane_ids=("ahead-0", "back-0")),)}, "neither follows 'ahead-0' nor lies beside it"),
        ({"routes": (MapRoute(lane_ids=("ahead-0",), start=-1.0),)}, "route 0 starts at -1.0"),
    ],
)
def test_validate_map_names_the_fault(changes, message):
    with pytest.raises(ValueError, match=message):
        validate_map(two_tile_map(**changes))


def test_connections_that_contradict_geometry_are_no_fault_of_a_map():
    far = map_lane("far", (500, 0), (600, 0))
    validate_map(two_tile_map(lanes=(*two_tile_map().lanes, far, map_lane("b", (0, 9), (1, 9), successors=("far",)))))


def test_log_and_map_hold_the_same_moment():
    log = example_log()
    map = validate_map(log_to_map(log, 3))
    back = validate_log(map_to_log(map))
    rows = np.flatnonzero(log.valid[:, 3])
    assert back.object_ids == tuple(log.object_ids[row] for row in rows) and back.lanes == log.lanes
    np.testing.assert_allclose(back.velocities[:, 0], log.velocities[rows, 3], atol=1e-12)
    np.testing.assert_array_equal(back.positions[:, 0], log.positions[rows, 3])
    np.testing.assert_array_equal(back.signal_states, log.signal_states[:, 3:4])


@pytest.mark.parametrize("step", [-1, 10])
def test_log_to_map_refuses_steps_outside_the_log(step):
    with pytest.raises(ValueError, match="give one of the 10 steps"):
        log_to_map(example_log(), step)


def test_find_route_takes_the_shortest_way():
    lanes = (
        map_lane("a", (0, 0), (10, 0), successors=("long", "short")),
        map_lane("long", (10, 0), (20, 30), (30, 0), successors=("b",)),
        map_lane("short", (10, 0), (30, 0)),
        map_lane("b", (30, 0), (40, 0), predecessors=("short",)),
    )
    map = Map(lanes=lanes)
    assert find_route(map, "a", "b").lane_ids == ("a", "short", "b")
    with pytest.raises(ValueError, match="no way leads from lane 'b'"):
        find_route(map, "b", "a")
    with pytest.raises(ValueError, match="no lane 'c'"):
        find_route(map, "a", "c")


def test_route_line_begins_and_ends_on_its_lanes():
    map = two_tile_map()
    line = route_line(map, map.routes[0])
    np.testing.assert_allclose(line[[0, -1], :2], [[-22, -2], [82, -2]])


def test_measure_seam_gives_gap_and_turn():
    map = two_tile_map()
    bent = map_lane("ahead-1", (32, -1), (60, 27), predecessors=("ahead-0",))
    measures = measure_seam(dataclasses.replace(map, lanes=(*map.lanes[:2], bent, map.lanes[3])), map.seams[0])
    np.testing.assert_allclose(measures.gaps, [1, 0])
    np.testing.assert_allclose(np.rad2deg(measures.turns), [45, 0], atol=1e-9)


def test_scene_to_map_turns_and_moves_a_scene():
    scene: Scene = two_way_road().scene()
    map = validate_map(
        scene_to_map(scene, x=100.0, y=-50.0, z=3.0, yaw=np.pi / 2, name="t", status=TileStatus.COMPLETE)
    )
    assert map.tiles[0].status == TileStatus.COMPLETE and len(map.tiles[0].lane_ids) == scene.num_lanes
    lane = scene.lanes[0].astype(np.float64)
    np.testing.assert_allclose(map.lanes[0].points[:, :2], np.stack([100 - lane[:, 1], lane[:, 0] - 50], -1), atol=1e-5)
    np.testing.assert_allclose(map.agents[0, [0, 1, 4, 5]], [100, -50, 0, 1], atol=1e-6)


def test_join_maps_lists_the_connections_of_a_seam():
    first, second = (
        Map(
            lanes=(map_lane(f"{k}", (64 * k - 32, 0), (64 * k + 32, 0)),),
            tiles=(MapTile(x=64.0 * k, y=0.0, lane_ids=(f"{k}",)),),
        )
        for k in (0, 1)
    )
    seam = MapSeam(tiles=(0, 1), start=(32.0, -32.0), end=(32.0, 32.0), connections=(("0", "1"),))
    map = validate_map(join_maps(first, second, seams=(seam,)))
    assert map.lanes[0].successors == ("1",) and map.lanes[1].predecessors == ("0",)
    third = Map(lanes=(map_lane("2", (96, 0), (160, 0)),), tiles=(MapTile(x=128.0, y=0.0, lane_ids=("2",)),))
    assert validate_map(join_maps(third, map)).seams[0].tiles == (1, 2)
    with pytest.raises(ValueError, match="share ids of lanes"):
        join_maps(first, first)
    with pytest.raises(ValueError, match="'0' or '9' is no lane"):
        join_maps(first, second, [("0", "9")])
