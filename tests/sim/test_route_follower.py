"""How vehicles drive by default: the law of following, signals, right of way, pedestrians."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.metrics.driving import driving_sums
from scjax.scene import AgentType, Signal
from scjax.sim.driver import ADVERSARIAL, DriverSettings
from scjax.sim.route_follower import RouteFollower
from scjax.sim.simulate import simulate
from tests.factories.road_maps import agent, crossing, merge, road, signaled_road, with_agents

STEADY = DriverSettings(speed_deviation=0.0)
SECONDS = 50.0  # another number of steps is another program, which takes seconds to compile


def _simulate(source, seconds=SECONDS, driver=STEADY, key=0, **options):
    return simulate(key, source, seconds=seconds, behavior=RouteFollower(driver, entry_delay=None, **options))


def _speed(log, row):
    return np.hypot(*log.velocities[row].T)


def test_a_free_road_is_driven_at_its_speed():
    log = _simulate(with_agents([road(3000.0)], [agent(5.0, 0.0)]))
    assert _speed(log, 0)[-1] == pytest.approx(14.0, rel=0.01)


def test_equilibrium_gap_behind_a_leader_at_constant_speed():
    """(s0 + v T) / sqrt(1 - (v / v0)^4), behind a cyclist."""
    driver = STEADY
    log = _simulate(
        with_agents([road(3000.0)], [agent(10.0, 0.0, speed=8.0), agent(40.0, 0.0, speed=8.0)], [0, AgentType.CYCLIST]),
        driver=driver,
    )
    speed = _speed(log, 1)[-1]
    gap = log.positions[1, -1, 0] - log.positions[0, -1, 0] - 4.5
    expected = (driver.min_gap + speed * driver.time_headway) / np.sqrt(1 - (speed / 14.0) ** 4)
    assert _speed(log, 0)[-1] == pytest.approx(speed, rel=0.01)
    assert gap == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("driver", [STEADY, ADVERSARIAL])
def test_a_platoon_never_collides(driver):
    cars = [agent(10.0 + 8.0 * k, 0.0, speed=12.0) for k in range(9)]
    log = _simulate(with_agents([road(400.0)], [*cars, agent(180.0, 0.0)], None), driver=driver)
    assert driving_sums(log)["vehicle_collision"][0] == 0


@pytest.mark.parametrize("speed", [5.0, 10.0, 14.0])
def test_vehicles_stop_before_a_red_signal(speed):
    log = _simulate(signaled_road(Signal.STOP, [agent(65.0, 0.0, speed=speed)]))
    red = log.signal_states[0] == Signal.STOP
    front = log.positions[0, :, 0] + 2.25
    stands = red & (_speed(log, 0) < 0.05) & (front > 90.0)
    assert stands.any()
    assert 0.2 < 100.0 - front[stands].max() < 2.5
    assert not (red[:-1] & (front[:-1] < 100.0) & (front[1:] >= 100.0)).any()


def test_signals_run_through_phases_and_vehicles_go_on_at_green():
    log = _simulate(signaled_road(Signal.STOP, [agent(20.0, 0.0, speed=8.0)]))
    assert set(log.signal_states[0].tolist()) == {Signal.GO, Signal.CAUTION, Signal.STOP}
    assert log.signal_states[0, 0] == Signal.STOP
    assert not log.valid[0, -1] or log.positions[0, -1, 0] > 110.0


def test_unknown_signals_stay_unknown_and_stop_nobody():
    log = _simulate(signaled_road(Signal.UNKNOWN, [agent(20.0, 0.0, speed=8.0)]))
    assert (log.signal_states == Signal.UNKNOWN).all()
    assert log.positions[0, log.valid[0], 0].max() > 150.0


@pytest.mark.parametrize("first, second", [(50.0, -50.0), (40.0, -50.0), (50.0, -40.0)])
def test_one_vehicle_gives_way_where_roads_cross(first, second):
    log = _simulate(crossing([agent(first, 0.0, speed=10.0), agent(100.0, second, 90.0, speed=10.0)]))
    assert driving_sums(log)["vehicle_collision"][0] == 0
    assert min(_speed(log, 0)[log.valid[0]].min(), _speed(log, 1)[log.valid[1]].min()) < 9.0
    assert (log.positions[0, log.valid[0], 0].max() > 130.0) and (log.positions[1, log.valid[1], 1].max() > 30.0)


def test_the_straight_road_goes_first_where_roads_merge():
    log = _simulate(merge([agent(40.0, 0.0, speed=10.0), agent(40.0, -18.0, 16.7, speed=10.0)]))
    assert driving_sums(log)["vehicle_collision"][0] == 0
    both = log.valid[0] & log.valid[1]
    assert (log.positions[0, both, 0] - log.positions[1, both, 0])[-1] > 4.5 or not both[-1]


def test_vehicles_stop_for_a_pedestrian_who_crosses():
    walker = agent(100.0, -4.0, 90.0, speed=1.3, size=(0.6, 0.6, 1.7))
    source = with_agents([road(200.0)], [agent(60.0, 0.0, speed=10.0), walker], [0, AgentType.PEDESTRIAN])
    log = _simulate(source)
    assert driving_sums(log)["collision"][0] == 0
    assert log.positions[1, -1, 1] > 3.0


def test_lanes_swerve_around_a_parked_vehicle():
    source = with_agents([road(200.0)], [agent(20.0, 0.0, speed=8.0), agent(80.0, 1.9)])
    log = _simulate(source)
    assert driving_sums(log)["vehicle_collision"][0] == 0
    near = log.valid[0] & (np.abs(log.positions[0, :, 0] - 80.0) < 3.0)
    assert near.any() and log.positions[0, near, 1].min() < -0.3
    assert log.positions[1, -1, 0] == pytest.approx(80.0)


def test_vehicles_change_lanes_to_pass_a_slower_one():
    from scjax.scene.map_lane import LaneNeighbor
    from scjax.sim.lane_changes import LaneChanges

    lanes = (
        road(600.0, y=0.0, name="right", left_neighbors=(LaneNeighbor("left"),)),
        road(600.0, y=3.5, name="left", right_neighbors=(LaneNeighbor("right"),)),
    )
    bicycle = agent(60.0, 0.0, speed=5.0, size=(1.8, 0.7, 1.7))
    source = with_agents(lanes, [agent(20.0, 0.0, speed=12.0), bicycle], [0, AgentType.CYCLIST])
    log = _simulate(source, 20.0, lane_changes=LaneChanges())
    assert driving_sums(log)["collision"][0] == 0
    assert log.positions[0, -1, 0] > log.positions[1, -1, 0] + 10.0
    assert log.positions[0, :, 1].max() == pytest.approx(3.5, abs=0.3)


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="time_headway is 0"):
        DriverSettings(time_headway=0.0)
    with pytest.raises(ValueError, match="speed_deviation"):
        DriverSettings(speed_deviation=2.0)
