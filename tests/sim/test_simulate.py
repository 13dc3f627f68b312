"""Roll-outs as a whole: what a log holds, what does not matter, and bad input."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.scene import AgentType, Signal, log_to_map, map_to_log, validate_log
from scjax.sim.behaviors import BEHAVIORS, as_behavior
from scjax.sim.constant_velocity import ConstantVelocity
from scjax.sim.driver import DriverSettings
from scjax.sim.route_follower import RouteFollower
from scjax.sim.simulate import simulate
from tests.factories.examples import example_scene
from tests.factories.maps import map_lane
from tests.factories.road_maps import agent, crossing, road, signaled_road, with_agents

SECONDS = 20.0  # another number of steps, or another behavior, is another program, which takes seconds to compile
STEADY = RouteFollower(DriverSettings(speed_deviation=0.0), entry_delay=None)


def _traffic():
    return crossing([agent(30.0, 0.0, speed=8.0), agent(60.0, 0.5, speed=6.0), agent(100.0, -40.0, 90.0, speed=9.0)])


def _equal(one, other):
    for name in ("valid", "positions", "headings", "velocities", "signal_states"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_step_0_is_the_moment_itself():
    source = _traffic()
    log = validate_log(simulate(0, source, seconds=SECONDS))
    assert log.num_steps == 201 and log.dt == pytest.approx(0.1)
    np.testing.assert_allclose(log.positions[:3, 0], source.agents[:, :3], atol=1e-4)
    assert log.object_ids[:3] == source.agent_ids and log.lanes == source.lanes


def test_nobody_jumps_at_the_first_step():
    source = with_agents([road(200.0)], [agent(20.0, 0.8, 9.0, speed=6.0), agent(60.0, -0.7, -5.0)])
    log = simulate(0, source, seconds=SECONDS)
    moved = np.hypot(*(log.positions[:2, 1] - log.positions[:2, 0])[:, :2].T)
    np.testing.assert_allclose(moved, [0.6, 0.0], atol=0.06)
    assert np.abs(log.headings[:2, 1] - log.headings[:2, 0]).max() < 0.05


def test_every_name_is_another_behavior():
    assert len({as_behavior(name) for name in BEHAVIORS}) == len(BEHAVIORS)


@pytest.mark.parametrize("name", ["constant-velocity", "idm"])
def test_the_same_key_gives_the_same_log(name):
    one, other = (simulate(3, _traffic(), seconds=SECONDS, behavior=name) for _ in range(2))
    _equal(one, other)


def test_alone_equals_in_a_list():
    """A list is padded to the sizes of its largest member: here 64 instead of 32 agents, and a larger map."""
    crowd = [agent(5.0, 500.0 + 10 * k, speed=3.0) for k in range(40)]
    large = with_agents([road(60.0, y=500.0 + 10 * k, name=f"far{k}") for k in range(300)], crowd)
    sources = [_traffic(), signaled_road(Signal.GO, [agent(20.0, 0.0, speed=9.0)])]
    together = simulate(1, [large, *sources], seconds=SECONDS)[1:]
    for alone, listed in zip([simulate(1, s, seconds=SECONDS) for s in sources], together, strict=True):
        np.testing.assert_array_equal(alone.valid, listed.valid)
        for name in ("positions", "headings", "velocities"):
            np.testing.assert_allclose(getattr(alone, name), getattr(listed, name), atol=1e-4)


def test_a_map_that_is_moved_and_turned_gives_the_same_traffic():
    bend = map_lane("bend", (0.0, 0.0), (60.0, 0.0), (90.0, 8.0), (110.0, 30.0), (118.0, 120.0))
    source = with_agents([bend], [agent(10.0, 0.4, 3.0, speed=9.0), agent(40.0, -0.3, speed=5.0), agent(70.0, 10.0)])
    angle, shift = 0.7, np.array([500.0, -300.0, 0.0])
    turn = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    agents = source.agents.copy()
    agents[:, :3] = agents[:, :3] @ turn + shift
    agents[:, 4:6] = agents[:, 4:6] @ turn[:2, :2]
    lanes = tuple(dataclasses.replace(lane, points=lane.points @ turn + shift) for lane in source.lanes)
    other = simulate(0, dataclasses.replace(source, lanes=lanes, agents=agents), seconds=SECONDS, behavior=STEADY)
    one = simulate(0, source, seconds=SECONDS, behavior=STEADY)
    np.testing.assert_allclose(one.positions @ turn + shift * one.valid[..., None], other.positions, atol=0.05)


def test_the_order_of_agents_does_not_matter():
    source = _traffic()
    rows = [2, 0, 1]
    other = dataclasses.replace(
        source, agents=source.agents[rows], agent_ids=tuple(source.agent_ids[row] for row in rows)
    )
    one, permuted = (simulate(0, m, seconds=SECONDS, behavior=STEADY) for m in (source, other))
    np.testing.assert_allclose(one.positions[rows], permuted.positions, atol=1e-3)


def test_vehicles_leave_the_map_and_others_enter():
    log = simulate(0, with_agents([road(60.0)], [agent(40.0, 0.0, speed=12.0)]), seconds=SECONDS)
    assert log.object_ids[0] == "a0" and not log.valid[0, -1]
    assert log.num_objects > 1 and log.object_ids[1] == "a0.1"
    begin = np.flatnonzero(log.valid[1])[0]
    assert begin > np.flatnonzero(log.valid[0])[-1] and log.positions[1, begin, 0] < 10.0


def test_parked_vehicles_and_obstacles_stay():
    source = with_agents(
        [road(100.0)],
        [agent(20.0, 12.0), agent(40.0, 0.0, size=(0.5, 0.5, 0.8))],
        [AgentType.VEHICLE, AgentType.STATIC],
    )
    log = simulate(0, source, seconds=SECONDS)
    np.testing.assert_allclose(log.positions[:, 0], log.positions[:, -1], atol=1e-4)


def test_scenes_maps_and_logs_give_the_same_traffic():
    source = _traffic()
    one, other = (simulate(0, s, seconds=SECONDS) for s in (source, map_to_log(source)))
    _equal(one, other)
    log = simulate(0, example_scene(0), seconds=SECONDS)
    assert log.ego_index == 0 and log_to_map(log).num_agents == example_scene(0).num_agents


def test_unknown_z_and_sizes_stay_unknown():
    source = _traffic()
    agents = source.agents.copy()
    agents[0, [2, 6, 7, 8]] = np.nan
    log = simulate(0, dataclasses.replace(source, agents=agents), seconds=SECONDS)
    assert np.isnan(log.positions[0, log.valid[0], 2]).all() and np.isnan(log.sizes[0]).all()
    assert np.isfinite(log.positions[1, log.valid[1]]).all()


def test_many_agents_are_simulated_and_too_many_refused():
    cars = [agent(8.0 * k, 0.0) for k in range(1000)]
    log = simulate(0, with_agents([road(8100.0)], cars), seconds=0.5, behavior=ConstantVelocity())
    assert log.num_objects == 1000
    with pytest.raises(ValueError, match="1025 agents are more than 1024"):
        simulate(0, with_agents([road(9000.0)], [agent(8.0 * k, 0.0) for k in range(1025)]), seconds=0.5)


def test_agents_inside_each_other_do_not_block_each_other():
    source = with_agents([road(600.0)], [agent(20.0, 0.0, speed=8.0), agent(22.0, 0.3, speed=8.0)])
    log = validate_log(simulate(0, source, seconds=SECONDS))
    assert log.positions[:, log.valid.all(0), 0][:, -1].min() > 40.0


def test_bad_input_names_the_argument():
    with pytest.raises(ValueError, match="seconds"):
        simulate(0, _traffic(), seconds=0.0)
    with pytest.raises(ValueError, match="step is 3"):
        simulate(0, map_to_log(_traffic()), seconds=1.0, step=3)
    with pytest.raises(ValueError, match="behavior is 'fast'"):
        simulate(0, _traffic(), seconds=1.0, behavior="fast")
    with pytest.raises(ValueError, match="no lane with two distinct points"):
        simulate(0, with_agents([], [agent(0.0, 0.0)]), seconds=1.0)
