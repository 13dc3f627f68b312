"""Vehicles that keep a junction closed."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.sim.jams import JamWatch
from scjax.sim.preparation import prepare
from tests.factories.road_maps import agent, crossing

CARS = [agent(20.0, 0.0), agent(98.0, 0.0), agent(100.0, -4.5, 90.0), agent(60.0, 0.0)]
"""One that is driven, two that meet at the crossing (100, 0), and one that waits behind them."""


@pytest.fixture(scope="module")
def start():
    return prepare(crossing(CARS), 0, np.random.default_rng(0))


def rows_after(start, seconds: float, moves=None, driven: int = 0) -> list[int]:
    """Rows that are found within some time, looked at every two seconds."""
    watch = JamWatch()
    times = np.arange(0.0, seconds, 2.0).tolist()
    found = [watch.blocking_row(start, moves(clock) if moves else start.agents, clock, driven) for clock in times]
    return [row for row in found if row is not None]


def test_who_stands_in_a_junction_for_a_minute_is_found(start):
    assert not rows_after(start, 59.0)
    assert rows_after(start, 69.0) == [1]


def test_who_stands_before_the_junction_is_not_found(start):
    assert 3 not in rows_after(start, 300.0)


def test_the_driven_vehicle_is_not_found(start):
    assert rows_after(start, 69.0, driven=1) == [2]


def test_others_have_ten_seconds_to_move_off(start):
    assert len(rows_after(start, 79.0)) == 2


def test_who_moves_on_slowly_is_not_found(start):
    def creeping(clock):
        x = np.array(start.agents.x)
        x[1] += 0.1 * clock
        return start.agents.replace(x=x)

    assert 1 not in rows_after(start, 80.0, creeping)
