"""Loose ends of lanes, and the dead turns that a repair leaves out."""

from __future__ import annotations

import numpy as np

from scjax.scene import Crop, Link, pad
from scjax.scene.loose_ends import loose_ends, remove_dead_turns
from scjax.scene.repair import repair
from tests.factories.repair_scenes import chain


def fork(turn=(10.0, 8.0)):
    """A road along x through the window, from which a lane turns off and ends inside."""
    scene = chain(0.0, lanes=3)
    for lane, (start, end) in enumerate((((-32, 0), (0, 0)), ((0, 0), (32, 0)), ((0, 0), turn))):
        scene.lanes[lane, :, :2] = np.linspace(start, end, 20)
    scene.links[:] = np.diag([Link.SELF] * 3)
    scene.links[0, 1:], scene.links[1:, 0] = Link.PREDECESSOR, Link.SUCCESSOR
    return scene


def test_ends_inside_the_window_are_loose_and_those_at_its_border_are_not():
    assert loose_ends(fork()) == [(2, False)]
    assert loose_ends(fork(turn=(10.0, 30.0))) == []
    assert loose_ends(fork().replace(crop=np.int32(Crop.FORWARD))) == [(1, False), (2, False)]


def test_ends_beside_a_way_back_or_on_another_lane_are_not_loose():
    there_and_back = chain(0.0, lanes=2)
    there_and_back.links[:] = np.diag([Link.SELF] * 2)
    there_and_back.lanes[0, :, :2] = np.linspace((-32, 0), (0, 0), 20)
    there_and_back.lanes[1, :, :2] = np.linspace((0, 4), (-32, 4), 20)
    assert loose_ends(there_and_back) == []
    there_and_back.lanes[1, :, :2] = np.linspace((0.5, 0), (32, 0), 20)
    assert loose_ends(there_and_back) == []


def test_a_dead_turn_is_left_out_and_all_else_stays():
    scene = pad(fork(), 1, 5)
    repaired = remove_dead_turns(scene)
    assert repaired.lanes.shape == scene.lanes.shape and int(repaired.lane_mask.sum()) == 2
    np.testing.assert_array_equal(repaired.lanes[:2], scene.lanes[:2])
    np.testing.assert_array_equal(repaired.links[:2, :2], scene.links[:2, :2])
    assert loose_ends(repaired) == [] and loose_ends(repair(scene)) == []


def test_lanes_that_are_known_or_driven_on_stay():
    scene = fork()
    assert int(repair(scene, known_lanes=1).lane_mask.sum()) == 3
    scene.agents[0, :2] = (8.0, 6.4)
    assert int(remove_dead_turns(scene).lane_mask.sum()) == 3


def test_a_road_without_another_way_stays():
    scene = fork()
    scene.links[0, 1] = scene.links[1, 0] = Link.NONE
    scene.lanes[1, :, :2] = np.linspace((-32, 5), (32, 5), 20)
    assert int(remove_dead_turns(scene).lane_mask.sum()) == 3


def test_a_short_way_from_the_border_to_nowhere_is_left_out_and_a_long_one_stays():
    for length, lanes in ((20.0, 2), (45.0, 3)):
        scene = fork()
        scene.links[0, 2] = scene.links[2, 0] = Link.NONE
        scene.lanes[2, :, :2] = np.linspace((32, 10), (32 - length, 10), 20)
        assert len(loose_ends(scene)) == 1 and int(remove_dead_turns(scene).lane_mask.sum()) == lanes
        scene.lanes[2] = scene.lanes[2, ::-1]  # from nowhere to the border
        assert len(loose_ends(scene)) == 1 and int(remove_dead_turns(scene).lane_mask.sum()) == lanes
