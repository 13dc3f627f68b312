"""Vehicles that leave the map and enter it again. Jitted, one scene."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from scjax.scene import AgentType
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents
from scjax.sim.road_network import NONE, RoadNetwork
from scjax.sim.routes import AXLE_SHARE, Routes, poses, remaining

_ARRIVED, _STANDS = 3.0, 0.5  # m from the front to the end of a road inside the map, m/s
_ENTRY_ROOM = 12.0  # m between a vehicle that enters and all others
_ENTRY_SPEED = 0.7  # of the speed of the road


def has_left(network: RoadNetwork, routes: Routes, agents: Agents) -> Bool[AnyArray, " N"]:
    """Whether an agent is past the end of a way that leads out of the map, or has stopped at one that ends inside."""
    rest, ends = remaining(network, routes)
    leads_out = network.is_exit[routes.last_lane]
    gone = leads_out & (rest < AXLE_SHARE * agents.length)
    arrived = ~leads_out & (rest < (0.5 + AXLE_SHARE) * agents.length + _ARRIVED) & (agents.speed < _STANDS)
    return ends & (gone | arrived)


def enter_map(
    key: Array, network: RoadNetwork, state: Any, agents: Agents, delay: float, dt: float
) -> tuple[Any, Agents]:
    """Vehicles that have left enter at a random lane that leads into the map, where there is room.

    Args:
      state: memory with ``routes`` and ``ignore``.
      delay: mean time until a vehicle tries [s].
    """
    num = agents.x.shape[0]
    time_key, lane_key = jax.random.split(key)
    waits = ~agents.valid & state.routes.has_route & (agents.kind == AgentType.VEHICLE)
    tries = waits & (jax.random.uniform(time_key, (num,)) < dt / delay)
    lane = entry_lanes(lane_key, network, num)
    tries = tries & network.is_entry.any()
    lanes = jnp.full_like(state.routes.lanes, NONE).at[:, 0].set(lane)
    zeros = jnp.zeros(num)
    fresh = Routes(lanes=lanes, along=zeros, lateral=zeros, lateral_speed=zeros, heading=zeros)
    x, y, z, heading = poses(network, fresh, agents.length, zeros)
    d_x, d_y = x[:, None] - agents.x[None], y[:, None] - agents.y[None]
    near = d_x * d_x + d_y * d_y < (_ENTRY_ROOM + 0.5 * (agents.length[:, None] + agents.length[None])) ** 2
    is_free = ~(near & agents.valid[None]).any(1)
    # Of several vehicles that choose the same lane in one step, the first enters.
    apart = (x[:, None] - x[None]) ** 2 + (y[:, None] - y[None]) ** 2
    earlier = jnp.arange(num)[None] < jnp.arange(num)[:, None]
    is_first = ~((apart < _ENTRY_ROOM**2) & earlier & tries[None]).any(1)
    enters = tries & is_free & is_first
    speed = _ENTRY_SPEED * network.limit[network.first[lane]]

    def choose(new, old):
        return jnp.where(enters.reshape((num,) + (1,) * (old.ndim - 1)), new, old)

    routes = jax.tree.map(choose, fresh, state.routes)
    agents = agents.replace(
        x=choose(x, agents.x),
        y=choose(y, agents.y),
        z=choose(z + 0.5 * agents.height, agents.z),
        heading=choose(heading, agents.heading),
        speed=choose(speed, agents.speed),
        valid=agents.valid | enters,
        entries=agents.entries + enters,
    )
    ignore = state.ignore & ~enters[:, None] & ~enters[None]
    state = state.replace(routes=routes, ignore=ignore)
    return state, agents


def entry_lanes(key: Array, network: RoadNetwork, num: int) -> Int[AnyArray, " N"]:
    """For each of ``num`` vehicles a lane that leads into the map, each as likely; one number a vehicle is drawn."""
    number = jnp.cumsum(network.is_entry.astype(jnp.int32))  # of entries up to each lane
    choice = jnp.floor(jax.random.uniform(key, (num,)) * number[-1]).astype(jnp.int32)
    lane = jnp.searchsorted(number, jnp.minimum(choice, number[-1] - 1), side="right")
    return jnp.minimum(lane, len(number) - 1).astype(jnp.int32)
