"""Who is ahead: bodies on the way of an agent, and vehicles on the lanes of its route. Jitted, one scene.

x and y stay separate arrays: a trailing axis of two would make the search over all pairs ten times slower.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from scjax.scene import AgentType
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents
from scjax.sim.directions import directions
from scjax.sim.road_network import RoadNetwork
from scjax.sim.routes import AXLE_SHARE, Routes, WayPoints, lane_starts

WINDOW = np.concatenate([np.arange(0.0, 16.0, 1.0), np.arange(16.0, 48.0, 2.0)]).astype(np.float32)
"""Distances ahead of the front bumper at which bodies are searched [m]."""
_BITS = np.uint32(1) << np.arange(len(WINDOW), dtype=np.uint32)  # one for each of the 32 distances
FRONT = 0.5 + AXLE_SHARE  # of the length, from the rear axle to the front bumper
_REAR = 0.5 - AXLE_SHARE  # from the rear bumper to the rear axle
_SIDE_GAP, _PARKED_SIDE_GAP = 0.25, 0.1  # m beside a moving and a standing body
_WALK_AHEAD = 1.5  # s of the way of pedestrians that vehicles keep free


class Leader(NamedTuple):
    """What each agent has to follow: the gap from bumper to bumper [m], infinite for none, and its speed [m/s]."""

    gap: Float[AnyArray, " N"]
    speed: Float[AnyArray, " N"]


def body_ahead(
    agents: Agents,
    way: WayPoints,
    front: Float[AnyArray, " N"],
    ignore: Bool[AnyArray, "N N"],
) -> Leader:
    """The first body on the way of each agent.

    Args:
      way: points ahead of the agents at ``front + WINDOW``.
      front: from the origin of the way's distances to the front bumper [m].
      ignore: pairs (agent, body) that do not count.
    """
    cos, sin = directions(agents.heading)
    walks = (agents.kind == AgentType.PEDESTRIAN) & (agents.speed > 0.3)
    ahead = jnp.where(walks, _WALK_AHEAD * agents.speed, 0.0)
    center_x, center_y = agents.x + 0.5 * ahead * cos, agents.y + 0.5 * ahead * sin
    half_length, half_width = 0.5 * (agents.length + ahead), 0.5 * agents.width
    gap_beside = jnp.where(agents.speed > 0.3, _SIDE_GAP, _PARKED_SIDE_GAP)
    room = 0.5 * agents.width[:, None] + gap_beside[None]  # [agent, body]
    tangent_x, tangent_y = way_tangents(way)

    def depth(x, y, t_x, t_y, body):
        """How far points are outside the body that is widened by the vehicle on its way, along the worse axis [m]."""
        b_x, b_y, c, s, b_half_length, b_half_width, b_room = body
        d_x, d_y = x - b_x, y - b_y
        across, along = jnp.abs(t_x * s - t_y * c), jnp.abs(t_x * c + t_y * s)
        return jnp.maximum(
            jnp.abs(d_x * c + d_y * s) - b_half_length - b_room * across,
            jnp.abs(d_y * c - d_x * s) - b_half_width - b_room * along,
        )

    bodies = (center_x, center_y, cos, sin, half_length, half_width)
    wide = tuple(value[None, :, None] for value in bodies)
    outside = depth(way.x[:, None], way.y[:, None], tangent_x[:, None], tangent_y[:, None], (*wide, room[:, :, None]))
    # A bit for each point: sums of whole numbers are several times as fast as a minimum of distances.
    hits = jnp.where((outside < 0) & way.inside[:, None], _BITS, jnp.uint32(0)).sum(-1, dtype=jnp.uint32)
    hits = jnp.where(ignore | ~agents.valid[None], jnp.uint32(0), hits)
    first = jax.lax.population_count((hits & -hits) - 1).astype(jnp.int32)  # the lowest bit; 32 if there is none
    body = jnp.argmin(first, axis=1)
    step = jnp.take_along_axis(first, body[:, None], axis=1)[:, 0]
    found, step = step < len(WINDOW), jnp.minimum(step, len(WINDOW) - 1)
    # The edge of the body lies between two points of the way: where the depth passes through zero.
    both = jnp.stack([jnp.maximum(step - 1, 0), step], axis=1)
    x, y, t_x, t_y, at = (
        jnp.take_along_axis(value, both, axis=1) for value in (way.x, way.y, tangent_x, tangent_y, way.distance)
    )
    its_room = jnp.take_along_axis(room, body[:, None], axis=1)
    low, high = depth(x, y, t_x, t_y, (*(value[body][:, None] for value in bodies), its_room)).T
    share = jnp.where((low > 0) & (high < 0), low / jnp.maximum(low - high, 1e-6), 1.0)
    edge = jnp.where(step > 0, at[:, 0] + share * (at[:, 1] - at[:, 0]), at[:, 1])
    forward = jnp.maximum(cos[body] * t_x[:, 1] + sin[body] * t_y[:, 1], 0.0)
    forward = jnp.where(walks[body], 0.0, forward)
    return Leader(jnp.where(found, edge - front, jnp.inf), jnp.where(found, agents.speed[body] * forward, 0.0))


def way_tangents(way: WayPoints) -> tuple[Float[AnyArray, "N W"], Float[AnyArray, "N W"]]:
    """Unit vectors along the way."""
    d_x, d_y = way.x[:, 1:] - way.x[:, :-1], way.y[:, 1:] - way.y[:, :-1]
    d_x = jnp.concatenate([d_x, d_x[:, -1:]], axis=1)
    d_y = jnp.concatenate([d_y, d_y[:, -1:]], axis=1)
    norm = jnp.sqrt(jnp.maximum(d_x * d_x + d_y * d_y, 1e-8))
    return d_x / norm, d_y / norm


def lane_leader(network: RoadNetwork, routes: Routes, agents: Agents) -> Leader:
    """The next vehicle whose rear axle is on a lane of the agent's route, however far ahead."""
    starts = lane_starts(network, routes)[:, :-1]
    distance = jnp.full((agents.x.shape[0],) * 2, jnp.inf)
    for k in range(routes.lanes.shape[1]):
        same = routes.lanes[:, k : k + 1] == routes.lanes[None, :, 0]
        apart = starts[:, k : k + 1] + routes.along[None] - routes.along[:, None]
        distance = jnp.where(same & (apart > 0), jnp.minimum(distance, apart), distance)
    known = routes.has_route & agents.valid
    distance = jnp.where(known[:, None] & known[None], distance, jnp.inf)
    leader = jnp.argmin(distance, axis=1)
    apart = jnp.take_along_axis(distance, leader[:, None], axis=1)[:, 0]
    gap = apart - FRONT * agents.length - _REAR * agents.length[leader]
    return Leader(gap, jnp.where(jnp.isfinite(gap), agents.speed[leader], 0.0))
