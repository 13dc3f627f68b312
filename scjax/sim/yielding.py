"""Who goes first where lanes cross or merge. Jitted, one scene.

Of each conflict only the next vehicle on either lane counts, and the vehicles that are inside. The order among two
vehicles is total, so they never wait for each other: who cannot stop any more, then the lane's right of way, then who
arrives first.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from scjax.scene.scene import AnyArray
from scjax.sim.agents import MAX_SIMULATED, Agents
from scjax.sim.leaders import FRONT, Leader
from scjax.sim.road_network import NONE, RoadNetwork
from scjax.sim.routes import Routes, lane_starts

HORIZON = 60.0  # m ahead in which conflicts count
_STOP_BEFORE = 1.0  # m before the conflict
_HARD_BRAKING = 4.0  # m/s^2 that drivers still accept in order to give way
_MARGIN = 1.0  # s between two vehicles
_STANDS = 0.5  # m/s
_PATIENCE = 6.0  # s, after which the right of way of a vehicle that stands rises by one rank
_START_ACCELERATION = 1.5  # m/s^2 of vehicles that set off
_FAR = 1e6
_UNIT = 2.0**-12  # m, of distances that are packed with a vehicle
_MAX_STEPS = 2**31 // MAX_SIMULATED - 2  # some 512 m
_NOBODY = jnp.iinfo(jnp.int32).max


class Claims(NamedTuple):
    """Of each conflict: the next vehicle that has not entered it (its index, -1 for none) and its distance [m];
    whether a vehicle is inside; of the one farthest from the end the distance to it [m] and the speed [m/s].
    """

    vehicle: Int[AnyArray, " C"]
    distance: Float[AnyArray, " C"]
    is_occupied: Bool[AnyArray, " C"]
    rest: Float[AnyArray, " C"]
    speed: Float[AnyArray, " C"]


def yield_leader(
    network: RoadNetwork,
    routes: Routes,
    agents: Agents,
    room: Float[AnyArray, " N"],
    waiting: Float[AnyArray, " N"],
) -> Leader:
    """What agents that give way have to stop for or follow, as a leader.

    Three rules dissolve deadlocks. Nobody gives way to a vehicle that something else holds up before the conflict. Of
    two that stand, the right of way of each rises with the time it has waited. After 6 s nobody waits any longer for a
    vehicle that stands inside; its body alone counts.

    Args:
      room: gap of each agent to what stands ahead of it or holds it up, such as a red signal [m].
      waiting: how long each agent has stood [s].
    """
    num = agents.x.shape[0]
    mine = _claims(network, routes, agents)
    yours = Claims(*(value[network.conflict_other] for value in mine))
    size = network.conflict_end - network.conflict_start
    your_size = size[network.conflict_other]
    merges = network.conflict_merges
    me, you = jnp.maximum(mine.vehicle, 0), jnp.maximum(yours.vehicle, 0)
    speed, your_speed = agents.speed[me], agents.speed[you]
    length, your_length = agents.length[me], agents.length[you]

    arrival, your_arrival = _time(mine.distance, speed), _time(yours.distance, your_speed)
    leave = _time(mine.distance + size + length, speed)
    your_leave = _time(yours.distance + your_size + your_length, your_speed)
    meet = (your_arrival < leave + _MARGIN) & (arrival < your_leave + _MARGIN)
    both_stand = (speed < _STANDS) & (your_speed < _STANDS)
    patience = jnp.where(both_stand, jnp.floor(waiting[me] / _PATIENCE), 0.0)
    score = _score(mine.distance, speed, network.conflict_rank + patience, arrival)
    your_score = score[network.conflict_other]
    you_first = (your_score > score) | ((your_score == score) & (you < me))
    is_held = (room[you] < yours.distance) & (your_speed < _STANDS)
    gives_way = (yours.vehicle >= 0) & (me != you) & you_first & meet & ~is_held

    stop = jnp.maximum(mine.distance - _STOP_BEFORE, 0.1)
    # Where lanes merge, vehicles follow the other one as if it were ahead. To stop before the conflict is enough.
    your_rest = jnp.where(yours.is_occupied, yours.rest, yours.distance + your_size + your_length)
    follow = mine.distance + size - your_rest
    follow_speed = jnp.where(follow > stop, jnp.where(yours.is_occupied, yours.speed, your_speed), 0.0)
    gap = jnp.where(merges, jnp.maximum(follow, stop), stop)
    lead_speed = jnp.where(merges, follow_speed, 0.0)
    is_occupied = yours.is_occupied & ~((yours.speed < _STANDS) & (speed < _STANDS) & (waiting[me] > _PATIENCE))
    counts = (mine.vehicle >= 0) & (gives_way | is_occupied)

    target = jnp.where(counts, me, num)
    nearest = jnp.full(num + 1, _FAR).at[target].min(gap)
    is_nearest = counts & (gap <= nearest[target])
    slowest = jnp.full(num + 1, _FAR).at[jnp.where(is_nearest, me, num)].min(lead_speed)
    found = nearest[:num] < _FAR
    return Leader(jnp.where(found, nearest[:num], jnp.inf), jnp.where(found, slowest[:num], 0.0))


def _claims(network: RoadNetwork, routes: Routes, agents: Agents) -> Claims:
    """The vehicles at every conflict."""
    count = network.conflict_start.shape[0]
    rows = network.conflicts[routes.lanes]  # [N, R, MAX_CONFLICTS]
    exists = (routes.lanes >= 0)[..., None] & (rows >= 0) & agents.valid[:, None, None]
    starts = lane_starts(network, routes)[:, :-1]
    base = (starts - routes.along[:, None])[..., None]
    front = (FRONT * agents.length)[:, None, None]
    to_start = base + network.conflict_start[rows] - front
    to_end = base + network.conflict_end[rows]  # of the rear axle
    rear = 0.2 * agents.length[:, None, None]
    waits = exists & (to_start > 0) & (to_start < HORIZON)
    inside = exists & (to_start <= 0) & (to_end + rear > 0)
    vehicle = jnp.broadcast_to(jnp.arange(agents.x.shape[0])[:, None, None], rows.shape)
    # One scatter finds both: the nearest vehicle of each conflict, and behind them the last one inside, negative.
    key = jnp.where(waits, _packed(to_start, vehicle), -_packed(to_end + rear, vehicle))
    row = jnp.where(waits, rows, jnp.where(inside, count + rows, 2 * count))
    least = jnp.full(2 * count, _NOBODY).at[row].min(key, mode="drop")
    nearest, rest = least[:count], -least[count:]
    is_claimed, is_occupied = nearest < _NOBODY, rest > -_NOBODY
    return Claims(
        vehicle=jnp.where(is_claimed, nearest % MAX_SIMULATED, NONE),
        distance=jnp.where(is_claimed, (nearest // MAX_SIMULATED) * _UNIT, _FAR),
        is_occupied=is_occupied,
        rest=jnp.where(is_occupied, (rest // MAX_SIMULATED) * _UNIT, -_FAR),
        speed=jnp.where(is_occupied, agents.speed[rest % MAX_SIMULATED], _FAR),
    )


def _packed(distance: Float[AnyArray, "*shape"], vehicle: Int[AnyArray, "*shape"]) -> Int[AnyArray, "*shape"]:
    """Distance and vehicle as one number in the order of distances: one scatter finds both."""
    steps = jnp.clip(distance / _UNIT, 0, _MAX_STEPS).astype(jnp.int32)
    return steps * MAX_SIMULATED + vehicle


def _time(distance: Float[AnyArray, "*shape"], speed: Float[AnyArray, "*shape"]) -> Float[AnyArray, "*shape"]:
    """Time until a vehicle has driven ``distance`` [s]: at its speed, or faster if it sets off."""
    distance = jnp.maximum(distance, 0.0)
    start = (jnp.sqrt(speed * speed + 2 * _START_ACCELERATION * distance) - speed) / _START_ACCELERATION
    return jnp.where(speed > 4.0, distance / jnp.maximum(speed, 1.0), start)


def _score(
    distance: Float[AnyArray, " C"],
    speed: Float[AnyArray, " C"],
    rank: Float[AnyArray, " C"],
    arrival: Float[AnyArray, " C"],
) -> Float[AnyArray, " C"]:
    """Order of two vehicles at a conflict: the higher one goes first."""
    committed = speed * speed / (2 * _HARD_BRAKING) > distance
    return 1000.0 * committed + 10.0 * rank - jnp.minimum(arrival, 9.9)
