"""Lane changes: for a better lane, where nobody has to brake hard. Jitted, one scene.

Kesting, Treiber, Helbing, "General lane-changing model MOBIL for car-following models", Transportation Research Record
1999 (2007): safety criterion and incentive with politeness.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from scjax.scene import AgentType
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents
from scjax.sim.directions import directions
from scjax.sim.driver import DriverSettings, idm_acceleration
from scjax.sim.leaders import FRONT, Leader
from scjax.sim.road_network import NONE, RoadNetwork
from scjax.sim.routes import Routes, lane_starts, poses

_BODY_ROOM = 2.0  # m ahead of and behind the place to which a vehicle moves
_MIN_SPEED = 2.0  # m/s


@dataclasses.dataclass(frozen=True)
class LaneChanges:
    """When vehicles change lanes.

    Attributes:
      politeness: weight of what the follower in the new lane loses.
      threshold: acceleration that has to be gained [m/s^2].
      safe_braking: at most, of the new follower [m/s^2].
      interval: mean time between two considerations [s].
      pause: between two changes [s].
      margin: no change so close to the end of a lane [m].
    """

    politeness: float = 0.2
    threshold: float = 0.2
    safe_braking: float = 3.0
    interval: float = 1.0
    pause: float = 4.0
    margin: float = 25.0


def apply_lane_changes(
    key: Array,
    network: RoadNetwork,
    state: Any,
    agents: Agents,
    ahead: Leader,
    driver: DriverSettings,
    options: LaneChanges,
    dt: float = 0.1,
) -> Any:
    """The memory of agents with new routes for those that change lanes; their offset keeps them where they are.

    Args:
      state: memory with ``routes``, ``factor`` and ``since_change``.
      ahead: the leader in the present lane.
    """
    num = agents.x.shape[0]
    side_key, time_key = jax.random.split(key)
    routes: Routes = state.routes
    to_left = jax.random.bernoulli(side_key, 0.5, (num,))
    considers = jax.random.uniform(time_key, (num,)) < dt / options.interval
    lane = routes.lanes[:, 0]
    target = jnp.where(to_left, network.left[lane], network.right[lane])
    span = jnp.where(to_left[:, None], network.left_span[lane], network.right_span[lane])
    share = (routes.along - span[:, 0]) / jnp.maximum(span[:, 1] - span[:, 0], 1.0)
    along = span[:, 2] + share * (span[:, 3] - span[:, 2])
    rest = span[:, 1] - routes.along
    possible = considers & routes.has_route & agents.valid & (target >= 0) & (share > 0)
    possible &= (rest > options.margin) & (agents.speed > _MIN_SPEED) & (state.since_change > options.pause)
    possible &= (jnp.abs(routes.lateral) < 0.5) & (agents.kind == AgentType.VEHICLE)

    lead, follower, follower_gap = _beside(network, routes, agents, jnp.where(possible, target, NONE), along)
    limit = network.limit[network.first[lane] + network.intervals[lane] // 2] * state.factor
    old = idm_acceleration(driver, agents.speed, limit, ahead.gap, ahead.speed)
    new = idm_acceleration(driver, agents.speed, limit, lead.gap, lead.speed)
    its_limit = jnp.maximum(limit, agents.speed[follower])
    braking = idm_acceleration(driver, agents.speed[follower], its_limit, follower_gap, agents.speed)
    free = idm_acceleration(
        driver,
        agents.speed[follower],
        its_limit,
        jnp.where(jnp.isfinite(follower_gap), follower_gap + lead.gap, jnp.inf),
        lead.speed,
    )
    loss = jnp.where(jnp.isfinite(follower_gap), jnp.maximum(free - braking, 0.0), 0.0)
    is_safe = ~jnp.isfinite(follower_gap) | ((braking > -options.safe_braking) & (follower_gap > driver.min_gap))
    gains = new - old - options.politeness * loss > options.threshold
    fresh = _routes_on(network, routes, agents, jnp.where(possible, target, lane), along)
    changes = possible & is_safe & gains & (lead.gap > driver.min_gap) & _has_room(network, fresh, agents)

    def choose(new_value, old_value):
        return jnp.where(changes.reshape((num,) + (1,) * (old_value.ndim - 1)), new_value, old_value)

    return state.replace(
        routes=jax.tree.map(choose, fresh, routes), since_change=jnp.where(changes, 0.0, state.since_change)
    )


def _beside(
    network: RoadNetwork, routes: Routes, agents: Agents, target: Int[AnyArray, " N"], along: Float[AnyArray, " N"]
) -> tuple[Leader, Int[AnyArray, " N"], Float[AnyArray, " N"]]:
    """The leader that agents would have on ``target``, their follower there, and the gap to it [m]."""
    starts = lane_starts(network, routes)[:, :-1]
    known = (routes.has_route & agents.valid)[None] & (target >= 0)[:, None]
    known &= ~jnp.eye(target.shape[0], dtype=bool)
    on_target = known & (routes.lanes[None, :, 0] == target[:, None])
    apart = routes.along[None] - along[:, None]
    to_lead = jnp.where(on_target & (apart > 0), apart, jnp.inf)
    lead = jnp.argmin(to_lead, axis=1)
    lead_gap = to_lead.min(1) - FRONT * agents.length - (1 - FRONT) * agents.length[lead]
    behind = jnp.full_like(to_lead, jnp.inf)
    for k in range(routes.lanes.shape[1]):
        distance = starts[None, :, k] - routes.along[None] + along[:, None]
        same = known & (routes.lanes[None, :, k] == target[:, None]) & (distance >= 0)
        behind = jnp.where(same, jnp.minimum(behind, distance), behind)
    follower = jnp.argmin(behind, axis=1)
    gap = behind.min(1) - FRONT * agents.length[follower] - (1 - FRONT) * agents.length
    return Leader(lead_gap, jnp.where(jnp.isfinite(lead_gap), agents.speed[lead], 0.0)), follower, gap


def _routes_on(
    network: RoadNetwork, routes: Routes, agents: Agents, target: Int[AnyArray, " N"], along: Float[AnyArray, " N"]
) -> Routes:
    """Routes that begin on ``target``, with the offset at which each agent is now."""
    lanes = jnp.full_like(routes.lanes, NONE).at[:, 0].set(target)
    zeros = jnp.zeros_like(along)
    fresh = Routes(lanes=lanes, along=along, lateral=zeros, lateral_speed=zeros, heading=zeros)
    x, y, _, heading = poses(network, fresh, agents.length, agents.speed)
    lateral = (agents.y - y) * jnp.cos(heading) - (agents.x - x) * jnp.sin(heading)
    return fresh.replace(lateral=lateral)


def _has_room(network: RoadNetwork, fresh: Routes, agents: Agents) -> Bool[AnyArray, " N"]:
    """Whether no body is at the place on the new lane."""
    x, y, _, heading = poses(network, fresh.replace(lateral=jnp.zeros_like(fresh.along)), agents.length, agents.speed)
    d_x, d_y = agents.x[None] - x[:, None], agents.y[None] - y[:, None]
    cos, sin = (part[:, None] for part in directions(heading))
    along, across = jnp.abs(d_x * cos + d_y * sin), jnp.abs(d_y * cos - d_x * sin)
    reach = 0.5 * (agents.length[:, None] + agents.length[None]) + _BODY_ROOM
    near = (along < reach) & (across < 0.5 * (agents.width[:, None] + agents.width[None]) + 0.3)
    near &= agents.valid[None] & ~jnp.eye(agents.x.shape[0], dtype=bool)
    return ~near.any(1)
