"""Agents of new tiles that come too near to others."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.sim.arrivals import arrivals_too_near
from scjax.sim.preparation import prepare
from tests.factories.road_maps import agent, crossing, road, with_agents


def _too_near(map) -> set[str]:
    """Of agents of which all but the first are new."""
    return arrivals_too_near(prepare(map, 0, np.random.default_rng(0)), set(map.agent_ids[1:]), set())


@pytest.mark.parametrize(("gap", "excluded"), [(1.0, {"a1"}), (20.0, set())])
def test_arrivals_ahead_leave_room_to_brake(gap, excluded):
    assert _too_near(with_agents([road()], [agent(50.0, 0.0, speed=8.0), agent(54.5 + gap, 0.0)])) == excluded


@pytest.mark.parametrize(("gap", "excluded"), [(1.0, {"a1"}), (20.0, set())])
def test_arrivals_behind_can_brake(gap, excluded):
    assert _too_near(with_agents([road()], [agent(54.5 + gap, 0.0), agent(50.0, 0.0, speed=8.0)])) == excluded


def test_arrivals_cross_where_nobody_can_brake_any_more():
    near, far = agent(100.0, -8.0, 90.0, speed=8.0), agent(100.0, -60.0, 90.0, speed=8.0)
    assert _too_near(crossing([agent(92.0, 0.0, speed=8.0), near, far])) == {"a1"}


def test_of_two_arrivals_that_overlap_the_first_stays():
    cars = [agent(10.0, 0.0), agent(50.0, 0.0), agent(52.0, 0.0), agent(58.0, 0.0)]
    assert _too_near(with_agents([road()], cars)) == {"a2"}


def test_oncoming_arrivals_stay_in_their_lanes():
    lanes = [road(), road(y=3.5, name="back")]
    assert not _too_near(with_agents(lanes, [agent(50.0, 0.0, speed=10.0), agent(62.0, 3.5, 180.0, speed=10.0)]))


def test_arrivals_that_a_parked_car_keeps_from_setting_off_stay_away():
    """The lane leaves room beside the parked car, but who stands close behind it does not get to its middle."""
    parked, near, far = agent(60.0, -2.2), agent(54.0, -1.2), agent(30.0, -1.2)
    assert _too_near(with_agents([road()], [parked, near, far])) == {"a1"}


@pytest.mark.parametrize(("y", "excluded"), [(-2.85, {"a1"}), (-2.95, set())])
def test_arrivals_pass_a_parked_car_at_the_distance_that_drivers_keep(y, excluded):
    parked, near = agent(60.0, y), agent(50.0, -1.4)
    assert _too_near(with_agents([road()], [parked, near])) == excluded
