"""The route of an agent that a policy drives: where it is on the lanes now. Jitted, one scene."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from scjax.scene.geometry import wrap_angle
from scjax.sim.agents import Agents
from scjax.sim.road_network import NONE, RoadNetwork
from scjax.sim.routes import AXLE_SHARE, Routes, advance, way_points

_SEARCH = np.arange(-4.0, 12.0, 1.0).astype(np.float32)  # m along the route
OFF_ROUTE = 2.0  # m to the side of the route, beyond which the nearest lane counts
_ANGLE_COST = 3.0  # m for each rad between the agent and a lane


def track_route(network: RoadNetwork, route: Routes, agent: Agents) -> Routes:
    """``route`` of one driven agent at its place now; if it has left the route, one that begins on the nearest lane.

    Args:
      route, agent: of a single agent, N = 1.
    """
    heading = agent.heading
    rear_x = agent.x - AXLE_SHARE * agent.length * jnp.cos(heading)
    rear_y = agent.y - AXLE_SHARE * agent.length * jnp.sin(heading)
    near = way_points(network, route, jnp.asarray(_SEARCH)[None])
    distance = jnp.where(near.inside, jnp.hypot(near.x - rear_x[:, None], near.y - rear_y[:, None]), jnp.inf)
    best = jnp.argmin(distance, axis=1)
    kept = advance(network, route, near.distance[:, best[0]])

    turn = jnp.abs(wrap_angle(network.heading - heading))
    point = jnp.argmin(jnp.hypot(network.x - rear_x, network.y - rear_y) + _ANGLE_COST * turn)
    lane = network.lane[point]
    fresh = jnp.full_like(kept.lanes, NONE).at[:, 0].set(lane)
    keeps = distance.min() < OFF_ROUTE
    lanes = jnp.where(keeps, kept.lanes, fresh)
    along = jnp.where(keeps, kept.along, (point - network.first[lane]) * network.spacing[lane])
    placed = route.replace(lanes=lanes, along=along)
    # The nearest point is up to half a spacing away: move by the rest along the lane.
    here = way_points(network, placed, jnp.array([[0.0, 2.0]]))
    angle = jnp.arctan2(here.y[:, 1] - here.y[:, 0], here.x[:, 1] - here.x[:, 0])
    offset_x, offset_y = rear_x - here.x[:, 0], rear_y - here.y[:, 0]
    rest = offset_x * jnp.cos(angle) + offset_y * jnp.sin(angle)
    return placed.replace(
        along=along + here.distance[:, 0] + jnp.clip(rest, -2.0, 2.0),
        lateral=offset_y * jnp.cos(angle) - offset_x * jnp.sin(angle),
        lateral_speed=jnp.zeros_like(along),
        heading=wrap_angle(heading - angle),
    )
