"""The policy that follows the route."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from scjax.sim.driver import NORMAL
from scjax.sim.observation import FAR, ROUTE_DISTANCES, Observation
from scjax.sim.policies import RoutePolicy

RADIUS, WIDTH = 8.0, 2.0  # m: of a bend to the right that begins at once, and of all cars


def _standing_before(body: tuple[float, float, float]) -> Observation:
    """A car that stands at the start of the bend, and a parked one at x, y, heading."""
    angle = np.minimum(ROUTE_DISTANCES / RADIUS, np.pi / 2)
    route = np.stack([RADIUS * np.sin(angle), RADIUS * (np.cos(angle) - 1)], -1)
    route[:, 1] -= np.maximum(ROUTE_DISTANCES - RADIUS * np.pi / 2, 0.0)
    x, y, heading = body
    agents = np.zeros((16, 7), np.float32)
    agents[0] = x, y, np.cos(heading), np.sin(heading), 0.0, 4.5, WIDTH
    return Observation(
        speed=jnp.float32(0.0),
        size=jnp.array([4.5, WIDTH]),
        lateral=jnp.float32(0.0),
        heading=jnp.float32(0.0),
        route=jnp.asarray(np.concatenate([route, np.full((20, 1), 8.0)], 1), jnp.float32),
        route_mask=jnp.ones(20, bool),
        stop_distance=jnp.float32(FAR),
        agents=jnp.asarray(agents),
        agent_types=jnp.zeros(16, jnp.int32),
        agent_mask=jnp.arange(16) < 1,
    )


@pytest.mark.parametrize(("gap", "drives"), [(1.3, True), (0.8, False)])
def test_route_policy_passes_a_parked_car_inside_a_bend_if_there_is_room(gap, drives):
    """``gap``: from the route to the corner of the car that is nearest to it [m]; half of the own width is 1 m."""
    angle = np.deg2rad(35.0)
    corner = np.array([0.0, -RADIUS]) + (RADIUS - gap) * np.array([np.sin(angle), np.cos(angle)])
    body = (corner[0] - WIDTH / 2, corner[1] - 2.25, np.pi / 2)  # the corner is at its front on the right
    action, _ = RoutePolicy()(_standing_before(body), None)
    assert (action.acceleration > 0.99 * NORMAL.acceleration) == drives
