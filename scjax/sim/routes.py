"""Routes over lanes: where agents are on them, what lies ahead, and how they go on. Jitted, one scene."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from scjax.scene.geometry import wrap_angle
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents
from scjax.sim.road_network import NONE, RoadNetwork

NUM_LANES = 6  # R, lanes of a route: the present one and those ahead
TURN_TEMPERATURE = 0.5  # rad; how much drivers prefer to go straight on
AXLE_SHARE = 0.3  # of the length, from the center of a vehicle to each axle


@pytree
class Routes(Replaceable):
    """The ways of N agents, who follow them with their rear axle.

    Attributes:
      lanes: the present lane and those that follow; -1 behind the end of the way and for agents without a route.
      along: of the rear axle on the first lane [m]; negative in front of its start.
      lateral, lateral_speed: of the agent to the left of the way [m, m/s].
      heading: relative to the way, fades out [rad].
    """

    lanes: Int[AnyArray, "N R"]
    along: Float[AnyArray, " N"]
    lateral: Float[AnyArray, " N"]
    lateral_speed: Float[AnyArray, " N"]
    heading: Float[AnyArray, " N"]

    @property
    def has_route(self) -> Bool[AnyArray, " N"]:
        """Whether the agent follows lanes."""
        return self.lanes[:, 0] >= 0

    @property
    def last_lane(self) -> Int[AnyArray, " N"]:
        """The last lane that is known of each way; -1 without a route."""
        count = (self.lanes >= 0).sum(1)
        return jnp.take_along_axis(self.lanes, jnp.maximum(count - 1, 0)[:, None], axis=1)[:, 0]


class WayPoints(NamedTuple):
    """Points of the lanes ahead of N agents, each with its distance [m] from the agent's rear axle.

    ``inside`` is False behind the end of the way.
    """

    x: Float[AnyArray, "N W"]
    y: Float[AnyArray, "N W"]
    z: Float[AnyArray, "N W"]
    limit: Float[AnyArray, "N W"]
    distance: Float[AnyArray, "N W"]
    inside: Bool[AnyArray, "N W"]


def lane_starts(network: RoadNetwork, routes: Routes) -> Float[AnyArray, "N R1"]:
    """Distance of the start of each lane of the route from the start of the first, and of the end of the last [m].

    A matrix product adds up the lengths: XLA would fuse ``cumsum`` into loops over pairs (``scjax.sim.directions``).
    """
    lengths = jnp.where(routes.lanes >= 0, network.length[routes.lanes], 0.0)
    count = lengths.shape[1]
    before = np.triu(np.ones((count, count + 1), np.float32), 1)
    return jnp.matmul(lengths, before, precision=jax.lax.Precision.HIGHEST)


def extend_routes(key: Array, network: RoadNetwork, routes: Routes) -> Routes:
    """Adds one lane to every route that has room for it and goes on; lanes that turn less are likelier."""
    lanes = routes.lanes
    count = (lanes >= 0).sum(1)
    following = network.successors[routes.last_lane]
    logits = jnp.where(following >= 0, -jnp.abs(network.turn[following]) / TURN_TEMPERATURE, -jnp.inf)
    noise = jax.random.gumbel(key, following.shape)
    choice = jnp.argmax(jnp.where(following >= 0, logits + noise, -jnp.inf), axis=1)
    lane = jnp.take_along_axis(following, choice[:, None], axis=1)[:, 0]
    goes_on = (count > 0) & (count < lanes.shape[1]) & (lane >= 0)
    slot = jnp.arange(lanes.shape[1])[None] == count[:, None]
    return routes.replace(lanes=jnp.where(slot & goes_on[:, None], lane[:, None], lanes))


def complete_routes(keys: Array, network: RoadNetwork, routes: Routes) -> Routes:
    """Routes with one more lane for each of ``keys``; a loop, so that it compiles once."""
    return jax.lax.scan(lambda some, key: (extend_routes(key, network, some), None), routes, keys)[0]


def advance(network: RoadNetwork, routes: Routes, distance: Float[AnyArray, " N"]) -> Routes:
    """The routes after agents have moved by ``distance`` [m]; lanes that are passed drop out, two at most."""
    lanes, along = routes.lanes, routes.along + distance
    for _ in range(2):
        length = network.length[lanes[:, 0]]
        passed = (lanes[:, 1] >= 0) & (along > length)
        along = jnp.where(passed, along - length, along)
        rolled = jnp.concatenate([lanes[:, 1:], jnp.full_like(lanes[:, :1], NONE)], axis=1)
        lanes = jnp.where(passed[:, None], rolled, lanes)
    return routes.replace(lanes=lanes, along=along)


def way_points(network: RoadNetwork, routes: Routes, distance: Float[AnyArray, "N W"]) -> WayPoints:
    """The points of the lanes nearest to ``distance`` [m] ahead of each rear axle."""
    starts = lane_starts(network, routes)
    position = routes.along[:, None] + distance
    lanes = routes.lanes
    first, spacing = network.first[lanes], network.spacing[lanes]
    intervals = network.intervals[lanes]
    row, gap, most = first[:, :1], spacing[:, :1], intervals[:, :1]
    begin = jnp.zeros_like(position)
    row, gap, most = (jnp.broadcast_to(value, position.shape) for value in (row, gap, most))
    for k in range(1, lanes.shape[1]):
        here = (position >= starts[:, k : k + 1]) & (lanes[:, k : k + 1] >= 0)
        row = jnp.where(here, first[:, k : k + 1], row)
        gap = jnp.where(here, spacing[:, k : k + 1], gap)
        most = jnp.where(here, intervals[:, k : k + 1], most)
        begin = jnp.where(here, starts[:, k : k + 1], begin)
    step = jnp.clip(jnp.round((position - begin) / gap).astype(jnp.int32), 0, most)
    index = row + step
    inside = (position <= starts[:, -1:] + 1.0) & routes.has_route[:, None]
    return WayPoints(
        x=network.x[index],
        y=network.y[index],
        z=network.z[index],
        limit=network.limit[index],
        distance=begin + step * gap - routes.along[:, None],
        inside=inside,
    )


def points_at(
    network: RoadNetwork, routes: Routes, distance: Float[AnyArray, " N"]
) -> tuple[Float[AnyArray, " N"], Float[AnyArray, " N"], Float[AnyArray, " N"]]:
    """x, y, z at exactly ``distance`` [m] ahead of each rear axle; straight on beyond either end of the way."""
    starts = lane_starts(network, routes)
    position = routes.along + distance
    valid = routes.lanes >= 0
    slot = ((position[:, None] >= starts[:, :-1]) & valid).sum(1) - 1
    slot = jnp.maximum(slot, 0)[:, None]
    lane = jnp.take_along_axis(routes.lanes, slot, axis=1)[:, 0]
    local = position - jnp.take_along_axis(starts, slot, axis=1)[:, 0]
    share = local / network.spacing[lane]
    step = jnp.clip(jnp.floor(share).astype(jnp.int32), 0, network.intervals[lane] - 1)
    index, rest = network.first[lane] + step, share - step
    x, y, z = (
        values[index] + rest * (values[index + 1] - values[index]) for values in (network.x, network.y, network.z)
    )
    return x, y, z


def poses(
    network: RoadNetwork, routes: Routes, length: Float[AnyArray, " N"], speed: Float[AnyArray, " N"]
) -> tuple[Float[AnyArray, " N"], Float[AnyArray, " N"], Float[AnyArray, " N"], Float[AnyArray, " N"]]:
    """x, y, z of the ground [m] and heading [rad] of agents of ``length`` [m]: both axles keep to the way."""
    rear_x, rear_y, rear_z = points_at(network, routes, jnp.zeros_like(length))
    front_x, front_y, front_z = points_at(network, routes, 2 * AXLE_SHARE * length)
    heading = jnp.arctan2(front_y - rear_y, front_x - rear_x)
    x = (rear_x + front_x) / 2 - routes.lateral * jnp.sin(heading)
    y = (rear_y + front_y) / 2 + routes.lateral * jnp.cos(heading)
    drift = jnp.arctan2(routes.lateral_speed, jnp.maximum(speed, 2.0))
    return x, y, (rear_z + front_z) / 2, heading + drift + routes.heading


def remaining(network: RoadNetwork, routes: Routes) -> tuple[Float[AnyArray, " N"], Bool[AnyArray, " N"]]:
    """Distance of each rear axle from the end of the way [m], and whether the way ends there: no lane follows."""
    starts = lane_starts(network, routes)
    return starts[:, -1] - routes.along, (network.successors[routes.last_lane, 0] < 0) & routes.has_route


def with_row(routes: Routes, row: Int[AnyArray, ""], route: Routes) -> Routes:
    """``routes`` with that of agent ``row`` replaced by ``route`` (N = 1), of which the first lanes count."""
    route = route.replace(lanes=route.lanes[:, : routes.lanes.shape[1]])
    return jax.tree.map(lambda every, one: every.at[row].set(one[0]), routes, route)


def fit_routes(network: RoadNetwork, routes: Routes, agents: Agents) -> Routes:
    """``routes`` whose ``poses`` are those of the agents: place, offset and heading on the way are corrected."""
    for _ in range(3):
        x, y, _, heading = poses(network, routes, agents.length, agents.speed)
        way = heading - routes.heading - jnp.arctan2(routes.lateral_speed, jnp.maximum(agents.speed, 2.0))
        d_x, d_y = agents.x - x, agents.y - y
        turn = agents.heading - way
        routes = routes.replace(
            along=routes.along + d_x * jnp.cos(way) + d_y * jnp.sin(way),
            lateral=routes.lateral + d_y * jnp.cos(way) - d_x * jnp.sin(way),
            heading=wrap_angle(turn),
        )
    return routes
