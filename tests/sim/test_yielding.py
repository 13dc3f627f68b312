"""Who goes first where roads cross, when vehicles stand and wait for each other."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from scjax.sim.preparation import prepare
from scjax.sim.route_follower import RouteFollower
from scjax.sim.yielding import yield_leader
from tests.factories.road_maps import agent, crossing

FREE = np.inf


@pytest.fixture(scope="module")
def gaps():
    """Gaps that right of way leaves to vehicle 0, from the west, and 1, from the south; both stand."""

    @jax.jit
    def gap(network, agents, places, room, waiting):
        routes = RouteFollower().start(jax.random.key(0), network, agents, places).routes
        return yield_leader(network, routes, agents, room, waiting).gap

    def of(west: float, south: float, room=(FREE, FREE), waiting=(0.0, 0.0)):
        source = crossing([agent(west, 0.0), agent(100.0, south, 90.0)])
        start = prepare(source, 0, np.random.default_rng(0))
        padded = [np.zeros(len(start.agents.x), np.float32) for _ in range(2)]
        for values, some in zip(padded, (room, waiting), strict=True):
            values[:2] = some
        return np.asarray(gap(start.network, start.agents, start.places, *padded))[:2]

    return of


def test_the_nearer_vehicle_goes_first(gaps):
    west, south = gaps(85.0, -20.0)
    assert west == FREE and south < 16.0


def test_nobody_gives_way_to_a_vehicle_that_is_held_up(gaps):
    assert gaps(85.0, -20.0, room=(4.0, FREE))[1] == FREE
    assert gaps(85.0, -20.0, room=(40.0, FREE))[1] < 16.0


def test_who_has_waited_longer_goes_first(gaps):
    west, south = gaps(85.0, -20.0, waiting=(1.0, 13.0))
    assert west < 11.0 and south == FREE


def test_nobody_waits_for_long_for_a_vehicle_that_stands_inside(gaps):
    assert gaps(95.75, -10.0, waiting=(1.0, 1.0))[1] < 6.0
    assert gaps(95.75, -10.0, waiting=(1.0, 7.0))[1] == FREE
