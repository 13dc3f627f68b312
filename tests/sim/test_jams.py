"""Vehicles that keep a junction or a lane closed."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.scene import AgentType
from scjax.sim.jams import JamWatch
from scjax.sim.preparation import prepare
from tests.factories.maps import map_lane
from tests.factories.road_maps import agent, crossing, road, with_agents

CARS = [agent(20.0, 0.0), agent(98.0, 0.0), agent(100.0, -4.5, 90.0), agent(60.0, 0.0)]
"""One that is driven, two that meet at the crossing (100, 0), and one that waits behind them."""


QUEUE = [agent(20.0, 0.0), agent(27.0, 0.0), agent(53.0, 0.0), agent(60.0, -0.5), agent(66.0, -2.6)]
"""One that is driven, one behind which it stands, and two behind a parked one."""


@pytest.fixture(scope="module")
def start():
    return prepare(crossing(CARS), 0, np.random.default_rng(0))


@pytest.fixture(scope="module")
def queue():
    return prepare(with_agents([road()], QUEUE), 0, np.random.default_rng(0))


def rows_after(start, seconds: float, moves=None, driven: int = 0) -> list[int]:
    """Rows that are found within some time, looked at every two seconds."""
    watch = JamWatch()
    times = np.arange(0.0, seconds, 2.0).tolist()
    found = [watch.blocking_row(start, moves(clock) if moves else start.agents, clock, driven) for clock in times]
    return [row for row in found if row is not None]


def test_who_stands_in_a_junction_for_long_is_found(start):
    assert not rows_after(start, 39.0)
    assert rows_after(start, 49.0) == [1]


def test_junctions_come_before_queues(start):
    assert 3 not in rows_after(start, 300.0)


def test_the_driven_vehicle_is_not_found(start):
    assert rows_after(start, 49.0, driven=1) == [2]


def test_others_have_ten_seconds_to_move_off(start):
    assert len(rows_after(start, 59.0)) == 2


def test_who_moves_on_slowly_is_not_found(start):
    def creeping(clock):
        x = np.array(start.agents.x)
        x[1] += 0.1 * clock
        return start.agents.replace(x=x)

    assert 1 not in rows_after(start, 80.0, creeping)


def test_the_first_of_a_queue_is_found_after_a_while(queue):
    assert not rows_after(queue, 39.0)
    assert rows_after(queue, 49.0, driven=1) == [3]


def test_who_stands_behind_others_or_is_parked_is_not_found(queue):
    assert set(rows_after(queue, 300.0, driven=1)) == {3}


def test_a_cyclist_that_stands_against_the_driven_vehicle_is_found():
    lanes = [road(100.0), map_lane("back", (100.0, 2.4, 0.0), (0.0, 2.4, 0.0))]
    agents = [agent(50.0, 0.0), agent(54.5, 0.6, 180.0, size=(1.8, 0.8, 1.8))]
    map = with_agents(lanes, agents, [AgentType.VEHICLE, AgentType.CYCLIST])
    assert set(rows_after(prepare(map, 0, np.random.default_rng(0)), 49.0)) == {1}
