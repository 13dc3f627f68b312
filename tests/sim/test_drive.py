"""Closed loop: a policy drives one agent."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from scjax.scene import AgentType, Signal, map_to_log, validate_log
from scjax.sim.bicycle import Action, VehiclePose, bicycle_action, bicycle_step
from scjax.sim.drive import drive
from tests.factories.road_maps import agent, crossing, road, signaled_road, with_agents

SECONDS = 20.0  # of every loop: another number of steps is another program, which takes seconds to compile
STAND, FULL_THROTTLE, NOT_A_NUMBER = (-3.0, -3.0), (6.0, 6.0), (np.nan, np.nan)


def _ten_steps(observation, state):
    """One acceleration for ten steps, then another; the state holds both and the number of steps."""
    first, then, number = state
    return Action(jnp.where(number < 10, first, then), jnp.float32(0.0)), (first, then, number + 1)


def _drive(source, accelerations):
    """A loop of the policy above."""
    state = (*map(jnp.float32, accelerations), jnp.int32(0))
    return drive(0, source, _ten_steps, policy_state=state, seconds=SECONDS)


@pytest.mark.parametrize("speed, acceleration, curvature", [(5.0, 1.0, 0.1), (0.5, 0.0, 0.0), (12.0, -4.0, -0.05)])
def test_the_bicycle_is_inverted(speed, acceleration, curvature):
    before = VehiclePose(*(jnp.float32(value) for value in (1.0, 2.0, 0.3, speed)))
    action = Action(jnp.float32(acceleration), jnp.float32(curvature))
    found = bicycle_action(before, bicycle_step(before, action, 0.1), 0.1)
    np.testing.assert_allclose(found, action, atol=1e-3)


def test_the_default_policy_follows_the_road_and_keeps_its_distance():
    source = with_agents([road(400.0)], [agent(10.0, 0.5, 3.0, speed=8.0), agent(60.0, 0.0, speed=3.0)], [0, 2])
    result = drive(0, source, seconds=SECONDS)
    log = validate_log(result.log)
    assert log.object_ids[log.ego_index] == result.actor == "a0"
    assert not result.terms["collides"].any() and not result.terms["off_road"].any()
    assert np.abs(log.positions[0, 30:, 1]).max() < 0.4
    travelled = log.positions[0, -1, 0] - log.positions[0, 0, 0]
    assert result.progress == pytest.approx(travelled, rel=0.02) and travelled > 60.0


def test_the_default_policy_passes_a_vehicle_parked_beside_its_lane():
    source = with_agents([road(200.0)], [agent(20.0, 0.0, speed=8.0), agent(80.0, 1.9)])
    result = drive(0, source, seconds=SECONDS)
    assert result.progress > 80.0 and not result.terms["collides"].any()


@pytest.mark.parametrize("degrees", [0.0, 90.0])
def test_the_default_policy_stops_behind_what_stands(degrees):
    source = with_agents(
        [road(200.0)], [agent(20.0, 0.0, speed=10.0), agent(80.0, 0.0, degrees)], [0, AgentType.STATIC]
    )
    log = drive(0, source, seconds=SECONDS).log
    front, rear = log.positions[0, -1, 0] + 2.25, 80.0 - (2.25 if degrees == 0.0 else 1.0)
    assert 0.8 < rear - front < 3.5 and np.hypot(*log.velocities[0, -1]) < 0.2


def test_the_default_policy_stops_at_red():
    result = drive(0, signaled_road(Signal.STOP, [agent(20.0, 0.0, speed=10.0)]), seconds=SECONDS)
    assert not result.terms["runs_red"].any()


def test_what_a_policy_does_wrong_shows_in_the_terms():
    red = _drive(signaled_road(Signal.STOP, [agent(60.0, 0.0, speed=14.0)]), FULL_THROTTLE)
    first_red = np.flatnonzero(red.log.signal_states[0] == Signal.STOP)
    crossed = np.flatnonzero(red.log.positions[0, :, 0] + 2.25 >= 100.0)[0]
    assert red.terms["runs_red"].any() == (crossed in first_red)
    source = with_agents([road(300.0)], [agent(20.0, 0.0, speed=10.0), agent(60.0, 0.0)], [0, AgentType.STATIC])
    hit = _drive(source, FULL_THROTTLE)
    assert hit.terms["collides"].any()
    far = with_agents([road(300.0)], [agent(20.0, 0.0, 45.0, speed=10.0)])
    assert _drive(far, FULL_THROTTLE).terms["off_road"].any()


def test_others_react_to_the_driven_agent():
    source = with_agents([road(300.0)], [agent(60.0, 0.0, speed=8.0), agent(30.0, 0.0, speed=8.0)])
    log = _drive(source, STAND).log
    assert log.positions[1, -1, 0] < log.positions[0, -1, 0] - 4.5
    assert np.hypot(*log.velocities[1, -1]) < 0.1


def test_an_action_that_is_not_finite_brakes():
    result = _drive(with_agents([road(300.0)], [agent(20.0, 0.0, speed=6.0)]), NOT_A_NUMBER)
    assert result.terms["invalid_action"].all()
    assert np.isfinite(result.log.positions).all() and np.hypot(*result.log.velocities[0, -1]) == 0.0


def test_policies_keep_their_state():
    source = with_agents([road(300.0)], [agent(20.0, 0.0)])
    log = _drive(source, (2.0, -6.0)).log
    speed = np.hypot(*log.velocities[0].T)
    assert speed[10] == pytest.approx(2.0, rel=0.01) and speed[-1] == 0.0


def test_the_end_of_the_map_is_an_arrival():
    result = drive(0, with_agents([road(60.0)], [agent(40.0, 0.0, speed=12.0)]), seconds=SECONDS)
    assert result.terms["arrives"].sum() == 1
    assert not result.log.valid[0, -1]


def test_actors_are_chosen_by_id():
    source = crossing([agent(30.0, 0.0, speed=8.0), agent(100.0, -40.0, 90.0, speed=9.0), agent(50.0, 30.0)])
    assert drive(0, source, actor="a1", seconds=SECONDS).actor == "a1"
    with pytest.raises(ValueError, match="actor is 'x'"):
        drive(0, source, actor="x", seconds=1.0)
    with pytest.raises(ValueError, match="'a2' follows no lane"):
        drive(0, source, actor="a2", seconds=1.0)
    with pytest.raises(ValueError, match="no agent follows a lane"):
        drive(0, with_agents([road(60.0)], [agent(10.0, 40.0)]), seconds=1.0)


def test_logs_do_not_grow_and_options_of_growing_need_it():
    source = with_agents([road(60.0)], [agent(10.0, 0.0)])
    with pytest.raises(ValueError, match="a log does not grow"):
        drive(0, map_to_log(source), grow="")
    with pytest.raises(ValueError, match="candidates is an option of maps that grow"):
        drive(0, source, candidates=2)
