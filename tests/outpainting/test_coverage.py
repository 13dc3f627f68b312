"""Covered ground, open ends, windows and exits of maps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.outpainting.coverage import Coverage, OpenEnd
from scjax.outpainting.dead_turns import DeadTurns
from scjax.outpainting.exits import choose_exit, ends_in_window, find_exits, pose_beyond, start_lane
from scjax.outpainting.measures import measure_map
from scjax.outpainting.window import KnownWindow, WindowPose, cut_window, trim_tails
from scjax.scene import Crop, TileStatus
from tests.factories.maps import map_lane, two_tile_map


def test_frames_of_windows_go_both_ways():
    pose = WindowPose(1e4, -2e4, 7.0, 2.1)
    points = np.random.default_rng(0).normal(size=(50, 3)) * 100
    assert np.abs(pose.to_window(pose.to_map(points)) - points).max() < 1e-9


def test_generated_tiles_cover_their_front_half_alone():
    coverage = Coverage(two_tile_map())
    inside = coverage.contains(np.array([[-31.0, 0], [31.0, 0], [70.0, 0], [95.0, 30], [97.0, 0], [40.0, 0]]))
    assert inside.tolist() == [True, True, True, True, False, False]
    opened = Coverage(two_tile_map(), opened=(64.0, 0.0, 0.0))
    assert opened.contains(np.array([[70.0, 0], [0.0, 0]])).tolist() == [False, True]


def test_missing_tiles_cover_nothing():
    map = two_tile_map()
    tiles = (map.tiles[0], dataclasses.replace(map.tiles[1], status=TileStatus.MISSING, lane_ids=()))
    assert (
        not Coverage(dataclasses.replace(map, lanes=map.lanes[:2], tiles=tiles)).contains(np.array([[70.0, 0]])).any()
    )


def test_open_ends_are_those_without_connection():
    ends = {(end.lane_id, end.is_start): end.at_border for end in Coverage(two_tile_map()).open_ends(two_tile_map())}
    assert ends == {
        ("ahead-0", True): True,
        ("back-0", False): True,
        ("ahead-1", False): True,
        ("back-1", True): True,
    }


def test_routes_leave_by_the_lanes_that_they_reach():
    (only,) = find_exits(two_tile_map(), "ahead-0")
    assert only.lane_ids == ("ahead-0", "ahead-1") and only.covered == 0
    assert (only.pose.x, only.pose.y, only.pose.yaw) == (95.5, -2.0, 0.0)
    assert choose_exit([only], np.random.default_rng(0), yaw=0.0, way="straight") is only
    assert choose_exit([only._replace(covered=0.9)], np.random.default_rng(0), yaw=0.0, way="random") is None


def test_routes_begin_on_the_nearest_lane_in_their_direction():
    assert start_lane(two_tile_map(), 0.0, 0.0, 0.0) == "ahead-0"
    assert start_lane(two_tile_map(), 0.0, 0.0, np.pi) == "back-0"
    with pytest.raises(ValueError, match="no lane leads on"):
        start_lane(two_tile_map(), 0.0, 0.0, np.pi / 2)


def test_short_tails_beyond_a_seam_are_cut_off():
    map = trim_tails(two_tile_map(), WindowPose(90.0, -2.0, 0.0, 0.0))
    assert map.lane_by_id["ahead-1"].points[-1, 0] == 90.0 == map.lane_by_id["back-1"].points[0, 0]
    assert trim_tails(two_tile_map(), WindowPose(64.0, -2.0, 0.0, 0.0)).lane_by_id["ahead-1"].points[-1, 0] == 96.0


def test_windows_show_what_is_behind_their_seam():
    pose = pose_beyond(two_tile_map().lane_by_id["ahead-1"].points)
    scene = cut_window(trim_tails(two_tile_map(), pose), pose)
    assert scene.crop == Crop.PARTITIONED and len(scene.lane_mask) == 2 and len(scene.agent_mask) == 1
    assert np.abs(scene.lanes[..., 0].max() - 0.0) < 1e-4 and scene.agents[0, 3] == 8.0
    inner = cut_window(two_tile_map(), WindowPose(32.0, -2.0, 0.0, 0.0))
    assert inner.crop == Crop.CENTERED and np.ptp(inner.lanes[..., 0]) > 60


def test_measures_of_a_map_by_hand():
    measures = measure_map(two_tile_map())
    assert (measures.length, measures.dead_ends, measures.largest_share) == (256.0, 0, 0.5)
    assert measures.gaps.tolist() == [0.0, 0.0] and measures.turns.max() < 1e-9
    assert (measures.complete, measures.tiles, measures.attempts) == (0, 1, 3)
    assert (measures.signaled, measures.differing) == (0, 0)
    signals = {"signal_lane_ids": ("ahead-0", "ahead-1"), "signal_positions": np.zeros((2, 3))}
    for states, differing in (([1, 1], 0), ([1, 3], 1)):
        lit = measure_map(two_tile_map(signal_states=np.array(states, np.int32), **signals))
        assert (lit.signaled, lit.differing) == (1, differing)
    stub = map_lane("stub", (40.0, 10.0), (44.0, 10.0))
    assert measure_map(two_tile_map(lanes=(*two_tile_map().lanes, stub))).dead_ends == 0  # on no covered ground
    stub = map_lane("stub", (70.0, 10.0), (80.0, 10.0))
    assert measure_map(two_tile_map(lanes=(*two_tile_map().lanes, stub))).dead_ends == 2


def test_tiles_on_whose_ground_a_lane_ends_dead_are_not_complete():
    map = two_tile_map()
    complete = dataclasses.replace(map.tiles[1], status=TileStatus.COMPLETE)
    missing = dataclasses.replace(complete, status=TileStatus.MISSING, lane_ids=())
    map = dataclasses.replace(map, tiles=(map.tiles[0], complete, missing))
    assert (measure_map(map).complete, measure_map(map).tiles, measure_map(map).missing) == (1, 1, 1)
    stub = map_lane("stub", (40.0, 10.0), (80.0, 10.0))
    assert measure_map(dataclasses.replace(map, lanes=(*map.lanes, stub))).complete == 0


@pytest.mark.parametrize(
    "end", [(80.0, 0.0, 0.0), (93.9, 0.0, 0.0), (94.1, 0.0, 0.0), (70.0, 29.9, 1.57), (63.0, 9.0, 0.0)]
)
def test_ends_are_dead_in_a_window_where_the_measure_of_the_map_says_so(end):
    """The window of the second tile, before that tile is there and afterwards."""
    x, y, yaw = end
    stub = map_lane("stub", (x - 9.0 * np.cos(yaw), y - 9.0 * np.sin(yaw)), (x, y))
    map = two_tile_map(lanes=(*two_tile_map().lanes, stub))
    before = dataclasses.replace(map, tiles=map.tiles[:1], seams=())
    pose = WindowPose(64.0, 0.0, 0.0, 0.0)
    window = KnownWindow(pose, before, cut_window(before, pose), (), DeadTurns(before, (), 0.0, 0.0))
    tiled = dataclasses.replace(
        map, tiles=(map.tiles[0], dataclasses.replace(map.tiles[1], lane_ids=("ahead-1", "stub")))
    )
    ends = {(one.lane_id, one.is_start): not one.at_border for one in Coverage(tiled).open_ends(tiled)}
    assert window.is_dead(np.array([x, y]), yaw) == ends["stub", False]


def test_ends_just_beside_a_window_that_lead_into_it_count():
    pose = WindowPose(64.0, 0.0, 0.0, 0.0)
    ends = [
        OpenEnd(name, False, np.array([x, y, 0.0]), 0.0, border)
        for name, x, y, border in (
            ("in", 63, 0, True),
            ("beside", 80, 33, True),
            ("far", 80, 40, True),
            ("dead", 63, 0, False),
        )
    ]
    assert [end.lane_id for end in ends_in_window(ends, pose)] == ["in", "beside"]
