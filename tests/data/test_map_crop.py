"""Scenes cut from maps: the same as from logs, anywhere, on maps of any size."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.data.log_crop import crop_log
from scjax.data.map_crop import crop_map, near_map
from scjax.scene import Crop, Link, Map, log_to_map, scene_to_map, validate, validate_map
from tests.factories.logs import example_log
from tests.factories.maps import map_lane, street_grid, two_tile_map


@pytest.mark.parametrize("crop", Crop)
def test_crop_map_around_an_agent_equals_crop_log(crop):
    log = example_log()
    expected = crop_log(log, 4, crop=crop)
    scene = crop_map(log_to_map(log, 4), agent="ego", crop=crop)
    for name, value in expected.to_dict().items():
        np.testing.assert_allclose(scene.to_dict()[name], value, atol=1e-4, err_msg=name)


def test_crop_map_at_a_place_has_a_standing_ego():
    scene = validate(crop_map(two_tile_map(), 40.0, -2.0, np.pi / 2))
    assert scene.num_agents == 1 and not scene.agent_known[0, 6:].any() and not scene.agent_known[0, 3]
    np.testing.assert_allclose(scene.agents[0, :6], [0, 0, 0, 0, 1, 0], atol=1e-6)
    assert scene.num_lanes == 2  # both lanes go on over the seam


def test_crop_map_without_an_ego_has_the_agents_of_the_window_alone():
    assert crop_map(two_tile_map(), 64.0, 0.0, ego=False).num_agents == 0
    assert crop_map(two_tile_map(), 20.0, 0.0, ego=False).num_agents == 1


def test_partitioned_crop_cuts_lanes_at_the_seam():
    scene = crop_map(two_tile_map(), 32.0, 0.0, crop=Crop.PARTITIONED)
    assert scene.num_lanes == 4 and (scene.links == Link.PREDECESSOR).sum() == 2


@pytest.mark.parametrize("yaw", [0.0, 1.0, np.pi])
def test_scene_of_a_tile_is_the_scene_that_made_it(yaw):
    scene = crop_map(two_tile_map(), 0.0, 0.0, agent="car")
    again = crop_map(scene_to_map(scene, x=5.0, y=-3.0, yaw=yaw, name="tile"), agent="tile.agent-0")
    np.testing.assert_allclose(again.lanes, scene.lanes, atol=1e-4)
    np.testing.assert_allclose(again.agents, scene.agents, atol=1e-4)
    np.testing.assert_array_equal(again.links, scene.links)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "x and y are missing"),
        ({"x": 0.0, "y": float("nan")}, "y must be a finite number"),
        ({"agent": "nobody"}, "agent is 'nobody'"),
        ({"x": 900.0, "y": 0.0}, "no lane is within 150 m"),
        ({"x": 0.0, "y": 60.0}, "no lane for cars is in the window"),
    ],
)
def test_crop_map_says_what_is_wrong(arguments, message):
    with pytest.raises(ValueError, match=message):
        crop_map(two_tile_map(), **arguments)


def test_lanes_of_no_length_and_impossible_connections_are_left_out():
    lanes = (
        map_lane("road", (-50, 0), (0, 0), successors=("far", "turned", "point", "next")),
        map_lane("next", (0, 0), (50, 0)),
        map_lane("far", (20, 20), (50, 20)),
        map_lane("turned", (0, 0), (-50, 1)),
        map_lane("point", (0, 0), (0, 0)),
        map_lane("single", (5, 5)),
    )
    scene = validate(crop_map(validate_map(Map(lanes=lanes)), 0.0, 0.0))
    assert scene.num_lanes == 3  # "next" continues "road"; "far" and "turned" stay apart
    assert not (scene.links == Link.PREDECESSOR).any()


def test_disconnected_lanes_give_a_scene_without_links():
    lanes = (map_lane("a", (-40, 0), (-1, 0)), map_lane("b", (1, 0), (40, 0)))
    assert not (crop_map(Map(lanes=lanes), 0.0, 0.0).links == Link.PREDECESSOR).any()


def test_crop_of_a_map_of_five_kilometers_works_on_the_lanes_nearby():
    map = street_grid(5000.0, spacing=250.0)
    near = near_map(map, 2500.0, 2500.0)
    assert map.num_lanes == 1680 and near.num_lanes == 8
    scene = crop_map(map, 2500.0, 2500.0, 0.3)
    np.testing.assert_array_equal(scene.lanes, crop_map(near, 2500.0, 2500.0, 0.3).lanes)
    assert scene.num_lanes == 4 and not (scene.links == Link.PREDECESSOR).any()  # merged through the crossing


def test_sharp_bends_of_long_lanes_stay_lanes_that_20_points_can_show():
    turn = np.linspace(0.0, np.pi / 2, 9)
    bend = np.stack([6 * np.sin(turn), 6 - 6 * np.cos(turn)], -1)
    lanes = (
        map_lane("a", (-60, 0), (0, 0), successors=("b",)),
        map_lane("b", *map(tuple, bend), successors=("c",)),
        map_lane("c", (6, 6), (6, 66)),
    )
    scene = crop_map(Map(lanes=lanes, has_topology=True), 0.0, 0.0)
    assert scene.num_lanes == 3 and (scene.links == Link.PREDECESSOR).sum() == 2
    steps = np.diff(np.asarray(scene.lanes)[..., :2], axis=1)
    turns = np.abs(np.diff(np.unwrap(np.arctan2(steps[..., 1], steps[..., 0]))))
    assert np.rad2deg(turns.max()) < 12
