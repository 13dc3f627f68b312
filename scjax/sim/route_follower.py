"""The default behavior: vehicles follow lanes by the intelligent driver model, give way and obey signals."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from scjax.scene import AgentType, Signal
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents, LanePlaces
from scjax.sim.border import enter_map, has_left
from scjax.sim.directions import directions
from scjax.sim.driver import NORMAL, DriverSettings, idm_acceleration
from scjax.sim.lane_changes import LaneChanges, apply_lane_changes
from scjax.sim.leaders import FRONT, WINDOW, Leader, body_ahead, lane_leader, way_tangents
from scjax.sim.road_network import NONE, RoadNetwork
from scjax.sim.routes import (
    AXLE_SHARE,
    NUM_LANES,
    Routes,
    WayPoints,
    advance,
    complete_routes,
    extend_routes,
    fit_routes,
    lane_starts,
    poses,
    remaining,
    way_points,
    with_row,
)
from scjax.sim.walking import usual_pace, walk
from scjax.sim.yielding import yield_leader

_CYCLIST_SPEED = 5.0  # m/s
_LATERAL_RATE = 1.2  # 1/s, of the return to the centerline
_RETURN_LENGTH = 12.0  # m over which the way ahead returns to the centerline
_HEADING_LENGTH = 5.0  # m over which a heading off the lane fades out
_SIGNAL_BRAKING = 3.0  # m/s^2; who would have to brake harder drives on at amber
_COMFORT = 1.5  # m/s^2 before bends
_STANDS = 0.5  # m/s
ON_ROAD = 1.8
"""m from a centerline, within which pedestrians do not stand for long."""


@pytree
class FollowerState(Replaceable):
    """Memory of ``RouteFollower`` for N agents.

    Attributes:
      routes: where they are and where they go.
      factor: desired speed relative to that of the road.
      ground: height of the box center above the lane [m].
      since_change: time since the last change of lanes [s].
      waiting: time since the agent moved [s].
      is_parked: never moves.
      pace: of pedestrians where nothing is in the way [m/s].
      ignore: pairs that overlap since the start and do not block each other.
    """

    routes: Routes
    factor: Float[AnyArray, " N"]
    ground: Float[AnyArray, " N"]
    since_change: Float[AnyArray, " N"]
    waiting: Float[AnyArray, " N"]
    is_parked: Bool[AnyArray, " N"]
    pace: Float[AnyArray, " N"]
    ignore: Bool[AnyArray, "N N"]


@dataclasses.dataclass(frozen=True)
class RouteFollower:
    """Vehicles and cyclists follow the lanes; pedestrians walk on and stop before vehicles.

    At a fork the way is drawn; straight on is likelier. Vehicles off the lanes roll to a stop.

    Attributes:
      driver: how they drive.
      lane_changes: when they change lanes (MOBIL); None for never.
      entry_delay: mean time until a vehicle that left the map enters it elsewhere [s]; None for never.
    """

    driver: DriverSettings = NORMAL
    lane_changes: LaneChanges | None = None
    entry_delay: float | None = 4.0

    def start(self, key: Array, network: RoadNetwork, agents: Agents, places: LanePlaces) -> FollowerState:
        """See ``BehaviorModel``."""
        num = agents.x.shape[0]
        lanes = jnp.full((num, NUM_LANES), NONE).at[:, 0].set(places.lane)
        routes = Routes(
            lanes=lanes,
            along=places.along - AXLE_SHARE * agents.length,
            lateral=places.lateral,
            lateral_speed=jnp.zeros(num),
            heading=places.heading,
        )
        keys = jax.random.split(key, NUM_LANES)
        speed_key, routes = keys[0], complete_routes(keys[1:], network, routes)
        routes = fit_routes(network, routes, agents)
        noise = jnp.clip(jax.random.normal(speed_key, (num,)), -2.0, 2.0)
        factor = self.driver.speed_factor * (1.0 + self.driver.speed_deviation * noise)
        here = way_points(network, routes, jnp.zeros((num, 1)))
        factor = jnp.maximum(factor, jnp.minimum(agents.speed / here.limit[:, 0], 1.5))
        center = way_points(network, routes, (AXLE_SHARE * agents.length)[:, None])
        ground = jnp.where(routes.has_route, agents.z - center.z[:, 0], 0.0)
        return FollowerState(
            routes=routes,
            factor=factor,
            ground=ground,
            since_change=jnp.full(num, 10.0),
            waiting=jnp.zeros(num),
            is_parked=places.is_parked,
            pace=usual_pace(agents, _distance_to_lanes(network, agents) < ON_ROAD),
            ignore=_touching(agents),
        )

    def step(
        self,
        key: Array,
        network: RoadNetwork,
        state: FollowerState,
        agents: Agents,
        signals: Int[AnyArray, " S"],
        dt: float,
    ) -> tuple[FollowerState, Agents]:
        """See ``BehaviorModel``."""
        route_key, change_key, entry_key = jax.random.split(key, 3)
        routes = state.routes
        follows = routes.has_route & agents.valid
        front = FRONT * agents.length
        way = _shifted(way_points(network, routes, front[:, None] + WINDOW[None]), routes.lateral)
        way = _straight_on(way, agents, routes.has_route)
        leaders = self._leaders(network, state, agents, signals, way, front)
        limit = self._limits(state, agents, way)
        acceleration = jnp.stack(
            [idm_acceleration(self.driver, agents.speed, limit, one.gap, one.speed) for one in leaders]
        ).min(0)
        acceleration = jnp.where(routes.has_route, acceleration, jnp.minimum(acceleration, -_COMFORT))
        speed = jnp.where(state.is_parked, 0.0, jnp.maximum(agents.speed + acceleration * dt, 0.0))
        distance = 0.5 * (agents.speed + speed) * dt

        routes = advance(network, _settle(routes, agents, distance, dt), jnp.where(follows, distance, 0.0))
        routes = extend_routes(route_key, network, routes)
        x, y, ground, heading = poses(network, routes, agents.length, speed)
        walked = walk(agents, state.pace, dt)
        walks = agents.kind == AgentType.PEDESTRIAN
        straight_x = agents.x + distance * jnp.cos(agents.heading)
        straight_y = agents.y + distance * jnp.sin(agents.heading)
        moved = agents.replace(
            x=jnp.where(walks, walked.x, jnp.where(follows, x, straight_x)),
            y=jnp.where(walks, walked.y, jnp.where(follows, y, straight_y)),
            z=jnp.where(follows, ground + state.ground, agents.z),
            heading=jnp.where(walks, walked.heading, jnp.where(follows, heading, agents.heading)),
            speed=jnp.where(walks, walked.speed, speed),
        )
        moved = _keep(agents, moved, state.is_parked | ~agents.valid)
        waiting = jnp.where(agents.speed < _STANDS, state.waiting + dt, 0.0)
        state = state.replace(routes=routes, since_change=state.since_change + dt, waiting=waiting)
        if self.lane_changes is not None:
            state = apply_lane_changes(change_key, network, state, moved, leaders[0], self.driver, self.lane_changes)
        moved = moved.replace(valid=moved.valid & ~has_left(network, state.routes, moved))
        if self.entry_delay is not None:
            state, moved = enter_map(entry_key, network, state, moved, self.entry_delay, dt)
        return state, moved

    def with_route(self, state: FollowerState, row: Int[AnyArray, ""], route: Routes) -> FollowerState:
        """See ``BehaviorModel``."""
        return state.replace(routes=with_row(state.routes, row, route))

    def _leaders(
        self,
        network: RoadNetwork,
        state: FollowerState,
        agents: Agents,
        signals: Int[AnyArray, " S"],
        way: WayPoints,
        front: Float[AnyArray, " N"],
    ) -> list[Leader]:
        """All that agents have to follow or stop for."""
        routes = state.routes
        ignore = state.ignore | jnp.eye(agents.x.shape[0], dtype=bool)
        body = body_ahead(agents, way, front, ignore)
        rest, ends = remaining(network, routes)
        stops = ends & ~network.is_exit[routes.last_lane]
        end = Leader(jnp.where(stops, jnp.maximum(rest - front - 0.5, 0.1), jnp.inf), jnp.zeros_like(rest))
        leaders = [lane_leader(network, routes, agents), body, end]
        if self.driver.stops_at_red:
            leaders.append(_red_signal(network, routes, agents, signals, front))
        if self.driver.yields:
            room = jnp.stack([jnp.where(one.speed < _STANDS, one.gap, jnp.inf) for one in leaders]).min(0)
            leaders.append(yield_leader(network, routes, agents, room, state.waiting))
        return leaders

    def _limits(self, state: FollowerState, agents: Agents, way: WayPoints) -> Float[AnyArray, " N"]:
        """Speeds that agents aim at, so that they are slow enough in the bends ahead [m/s]."""
        ahead = jnp.maximum(way.distance - way.distance[:, :1], 0.0)
        limit = way.limit * state.factor[:, None]
        limit = jnp.sqrt(limit * limit + 2 * _COMFORT * ahead)
        limit = jnp.where(way.inside, limit, jnp.inf).min(1)
        limit = jnp.where(agents.kind == AgentType.CYCLIST, jnp.minimum(limit, _CYCLIST_SPEED), limit)
        return jnp.where(jnp.isfinite(limit), limit, jnp.maximum(agents.speed, 0.5))


def _distance_to_lanes(network: RoadNetwork, agents: Agents) -> Float[AnyArray, " N"]:
    """Distance of each agent from the nearest centerline [m]."""
    d_x, d_y = agents.x[:, None] - network.x[None], agents.y[:, None] - network.y[None]
    return jnp.sqrt((d_x * d_x + d_y * d_y).min(1))


def _touching(agents: Agents) -> Bool[AnyArray, "N N"]:
    """Pairs of which the center of one lies in the box of the other, widened by half the width of the first."""
    d_x, d_y = agents.x[:, None] - agents.x[None], agents.y[:, None] - agents.y[None]
    cos, sin = directions(agents.heading)
    ahead, side = d_x * cos[None] + d_y * sin[None], d_y * cos[None] - d_x * sin[None]
    reach = 0.5 * agents.width[:, None]
    inside = (jnp.abs(ahead) < 0.5 * agents.length[None] + reach) & (jnp.abs(side) < 0.5 * agents.width[None] + reach)
    return inside | inside.T


def _shifted(way: WayPoints, lateral: Float[AnyArray, " N"]) -> WayPoints:
    """The way of an agent beside its centerline, to which it returns."""
    tangent_x, tangent_y = way_tangents(way)
    shift = lateral[:, None] * jnp.exp(-jnp.maximum(way.distance - way.distance[:, :1], 0.0) / _RETURN_LENGTH)
    return way._replace(x=way.x - shift * tangent_y, y=way.y + shift * tangent_x)


def _straight_on(way: WayPoints, agents: Agents, has_route: Bool[AnyArray, " N"]) -> WayPoints:
    """The way straight ahead for agents without a route."""
    front = FRONT * agents.length[:, None]
    ahead = 0.5 * agents.length[:, None] + jnp.asarray(WINDOW)[None]
    keep = has_route[:, None]
    cos, sin = directions(agents.heading)
    return WayPoints(
        x=jnp.where(keep, way.x, agents.x[:, None] + ahead * cos[:, None]),
        y=jnp.where(keep, way.y, agents.y[:, None] + ahead * sin[:, None]),
        z=way.z,
        limit=jnp.where(keep, way.limit, jnp.inf),
        distance=jnp.where(keep, way.distance, front + jnp.asarray(WINDOW)[None]),
        inside=way.inside | ~keep,
    )


def _red_signal(
    network: RoadNetwork, routes: Routes, agents: Agents, signals: Int[AnyArray, " S"], front: Float[AnyArray, " N"]
) -> Leader:
    """The first signal ahead at which an agent has to stop."""
    row = network.signal[routes.lanes]
    states = jnp.where((routes.lanes >= 0) & (row >= 0), signals[row], Signal.UNKNOWN)
    distance = lane_starts(network, routes)[:, :-1] - routes.along[:, None] - front[:, None]
    can_stop = distance > (agents.speed * agents.speed / (2 * _SIGNAL_BRAKING))[:, None]
    stops = (states == Signal.STOP) | ((states == Signal.CAUTION) & can_stop)
    gap = jnp.where(stops & (distance > -0.5), jnp.maximum(distance - 0.5, 0.1), jnp.inf).min(1)
    return Leader(gap, jnp.zeros_like(gap))


def _settle(routes: Routes, agents: Agents, distance: Float[AnyArray, " N"], dt: float) -> Routes:
    """Agents return to the centerline and to the heading of the lane as they move; cyclists keep to their side."""
    moves = jnp.minimum(agents.speed / 4.0, 1.0)
    rate = _LATERAL_RATE * moves
    rate = jnp.where(agents.kind == AgentType.CYCLIST, 0.0, rate)
    pull = -rate * rate * routes.lateral - 2 * rate * routes.lateral_speed
    lateral_speed = jnp.where(moves > 0.05, routes.lateral_speed + pull * dt, 0.0)
    return routes.replace(
        lateral=routes.lateral + lateral_speed * dt,
        lateral_speed=lateral_speed,
        heading=routes.heading * jnp.exp(-distance / _HEADING_LENGTH),
    )


def _keep(before: Agents, after: Agents, stays: Bool[AnyArray, " N"]) -> Agents:
    """``after`` with the poses of ``before`` where agents stay."""
    names = ("x", "y", "z", "heading", "speed")
    return after.replace(**{name: jnp.where(stays, getattr(before, name), getattr(after, name)) for name in names})
