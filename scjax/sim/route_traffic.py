"""Agents on routes -> what the behavior network knows of them. Jitted, one scene.

Other than those of ``RouteFollower``, these routes are followed by the center of an agent, which may leave them.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from scjax.models.behavior.config import STEP
from scjax.models.behavior.traffic import FAR, WAY, Traffic
from scjax.scene import AgentType, Signal
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents
from scjax.sim.road_network import RoadNetwork
from scjax.sim.routes import Routes, advance, lane_starts, points_at, remaining

_BEHIND = 1.0  # m behind a stop line, up to which the front of an agent still waits at it


def traffic_of(
    network: RoadNetwork,
    routes: Routes,
    agents: Agents,
    motions: Float[AnyArray, "N H 3"],
    known: Bool[AnyArray, "N H"],
    signals: Int[AnyArray, " S"],
) -> Traffic:
    """The traffic at one moment.

    Args:
      routes: ``along`` is that of the center.
      motions, known: see ``Traffic``.
      signals: ``Signal`` of every signal.
    """
    x, y, limit, inside = _points_ahead(network, routes, jnp.broadcast_to(jnp.asarray(WAY), (len(agents.x), len(WAY))))
    has_way = routes.has_route
    ahead = jnp.asarray(WAY)[None]
    straight_x = agents.x[:, None] + ahead * jnp.cos(agents.heading)[:, None]
    straight_y = agents.y[:, None] + ahead * jnp.sin(agents.heading)[:, None]
    signal, gap = _next_signal(network, routes, agents, signals)
    rest, ends = remaining(network, routes)
    return Traffic(
        x=agents.x,
        y=agents.y,
        heading=agents.heading,
        length=agents.length,
        width=agents.width,
        kind=agents.kind,
        valid=agents.valid,
        motions=jnp.asarray(motions),
        known=jnp.asarray(known),
        way_x=jnp.where(has_way[:, None], x, straight_x),
        way_y=jnp.where(has_way[:, None], y, straight_y),
        limit=jnp.where(has_way[:, None], limit, 0.0),
        inside=inside | ~has_way[:, None],
        has_way=has_way,
        signal=signal,
        signal_gap=gap,
        end_gap=jnp.where(ends & ~network.is_exit[routes.last_lane], jnp.clip(rest, 0.0, FAR), FAR),
    )


def track_routes(network: RoadNetwork, routes: Routes, agents: Agents) -> Routes:
    """The routes with the agents where the feet of their centers are."""
    zeros = jnp.zeros_like(agents.x)
    x, y, _ = points_at(network, routes, zeros)
    t_x, t_y = _direction(network, routes, zeros)
    step = (agents.x - x) * t_x + (agents.y - y) * t_y
    return advance(network, routes, jnp.where(routes.has_route & agents.valid, step, 0.0))


def first_motions(network: RoadNetwork, routes: Routes, agents: Agents) -> Float[Array, "N 3"]:
    """The motions of agents whose past is not known: straight on, or along the bend of the way."""
    distance = STEP * agents.speed
    b_x, b_y = _direction(network, routes, jnp.zeros_like(distance))
    e_x, e_y = _direction(network, routes, jnp.maximum(distance, 1.0))
    turn = jnp.arctan2(b_x * e_y - b_y * e_x, b_x * e_x + b_y * e_y) * distance / jnp.maximum(distance, 1.0)
    follows = routes.has_route & (agents.kind != AgentType.PEDESTRIAN)
    turn = jnp.where(follows, jnp.clip(turn, -0.2, 0.2), 0.0)
    return jnp.stack([distance, jnp.zeros_like(distance), turn], -1)


def _direction(network: RoadNetwork, routes: Routes, distance: Array) -> tuple[Array, Array]:
    """Unit vector of the way at a distance ahead, over 1 m."""
    b_x, b_y, _ = points_at(network, routes, distance - 0.5)
    e_x, e_y, _ = points_at(network, routes, distance + 0.5)
    norm = jnp.sqrt(jnp.maximum((e_x - b_x) ** 2 + (e_y - b_y) ** 2, 1e-8))
    return jnp.asarray((e_x - b_x) / norm), jnp.asarray((e_y - b_y) / norm)


def _points_ahead(
    network: RoadNetwork, routes: Routes, distance: Float[Array, "N W"]
) -> tuple[Array, Array, Array, Array]:
    """x, y [m] and speed limit [m/s] at ``distance`` [m] ahead, or at the end of the way; which are before the end."""
    starts = lane_starts(network, routes)
    position = routes.along[:, None] + distance
    lanes = routes.lanes
    slot = jnp.zeros(position.shape, jnp.int32)
    for k in range(1, lanes.shape[1]):
        slot = jnp.where((position >= starts[:, k : k + 1]) & (lanes[:, k : k + 1] >= 0), k, slot)
    lane = jnp.take_along_axis(lanes, slot, axis=1)
    local = position - jnp.take_along_axis(starts[:, :-1], slot, axis=1)
    intervals = network.intervals[lane]
    share = jnp.clip(local / network.spacing[lane], 0.0, intervals)
    step = jnp.minimum(jnp.floor(share).astype(jnp.int32), intervals - 1)
    index, rest = network.first[lane] + step, share - step
    x, y = (values[index] + rest * (values[index + 1] - values[index]) for values in (network.x, network.y))
    inside = jnp.asarray(position <= starts[:, -1:] + 0.5) & routes.has_route[:, None]
    return x, y, network.limit[index], jnp.asarray(inside)


def _next_signal(
    network: RoadNetwork, routes: Routes, agents: Agents, signals: Int[AnyArray, " S"]
) -> tuple[Array, Array]:
    """State and distance [m] of the first signal ahead that shows one."""
    row = network.signal[routes.lanes]
    states = jnp.where((routes.lanes >= 0) & (row >= 0), jnp.asarray(signals)[row], Signal.UNKNOWN)
    distance = lane_starts(network, routes)[:, :-1] - routes.along[:, None]
    counts = (states != Signal.UNKNOWN) & (distance > (0.5 * agents.length - _BEHIND)[:, None])
    gap = jnp.where(counts, distance, FAR)
    first = jnp.argmin(gap, axis=1)[:, None]
    gap = jnp.take_along_axis(gap, first, axis=1)[:, 0]
    state = jnp.take_along_axis(states, first, axis=1)[:, 0]
    return jnp.where(gap < FAR, state, Signal.UNKNOWN), gap
