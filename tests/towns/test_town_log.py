import dataclasses

import numpy as np
import pytest

from scjax.scene import LogMetadata, Signal, validate_log
from scjax.towns.town_log import SIGHT, TownMap, cut_log
from tests.factories.town_traffic import fork_log, fork_traffic, straight_track


@pytest.fixture
def log():
    near = straight_track("near", x=30.0, speed=4.0, start=60)
    far = straight_track("far", x=1000.0)
    traffic = fork_traffic(straight_track("ego"), near, far)
    traffic = dataclasses.replace(traffic, egos=np.array([[120, 0]]))
    return cut_log(TownMap(fork_log()), traffic, 0, LogMetadata(domain="carla", scene_id="x"))


def test_log_is_ten_seconds_around_its_moment(log):
    validate_log(log)
    assert log.num_steps == 101 and log.timestamps[[0, 20, -1]].tolist() == pytest.approx([-2.0, 0.0, 8.0])
    assert log.object_ids == ("ego", "near") and log.ego_index == 0 and log.valid[0].all()
    np.testing.assert_allclose(log.positions[0, :, 0], 50 + 0.5 * np.arange(101))


def test_velocities_are_those_of_the_positions(log):
    np.testing.assert_allclose(log.velocities[0], np.tile([5.0, 0.0], (101, 1)), atol=1e-9)
    np.testing.assert_allclose(log.velocities[1, log.valid[1], 0], 4.0, atol=1e-9)


def test_signals_change_with_time(log):
    assert log.signal_lane_ids == ("4.0.-1",)
    assert log.signal_states[0, 0] == Signal.GO and log.signal_states[0, -1] == Signal.STOP
    assert int((log.signal_states[0] == Signal.GO).sum()) == 50  # until step 150 of the simulation
    np.testing.assert_allclose(log.signal_positions, [[100, 0, 0]], atol=1e-6)


def test_objects_out_of_sight_are_left_out():
    ahead = straight_track("ahead", x=SIGHT + 70.0, speed=0.0)
    traffic = dataclasses.replace(fork_traffic(straight_track("ego"), ahead), egos=np.array([[120, 0]]))
    log = cut_log(TownMap(fork_log()), traffic, 0, LogMetadata())
    row = log.object_ids.index("ahead")
    assert not log.valid[row, :10].all() and log.valid[row, -1]


def test_lanes_near_are_those_within_reach():
    town = TownMap(fork_log())
    names = [town.log.lanes[row].id for row in town.lanes_near(np.array([[215.0, 0.0]]), 20.0)]
    assert names == ["2.0.-1"]
