"""One agent driven by a policy among agents that a behavior model moves: pure functions for one scene.

``scjax.drive`` scans them with a policy in JAX; the Gymnasium environment calls them step by step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from scjax.scene import Signal
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents, LanePlaces
from scjax.sim.behavior import BehaviorModel
from scjax.sim.bicycle import Action, VehiclePose, bicycle_step, finite_action
from scjax.sim.collisions import touching_bodies
from scjax.sim.road_network import NONE, RoadNetwork
from scjax.sim.routes import (
    AXLE_SHARE,
    NUM_LANES,
    Routes,
    complete_routes,
    extend_routes,
    lane_starts,
    remaining,
    way_points,
)
from scjax.sim.tracking import track_route

OFF_ROAD = 3.0  # m from the nearest centerline
_RESTING = -3.0  # m/s^2 of a vehicle whose policy gives no finite action


@pytree
class DrivingState(Replaceable):
    """All that changes in a closed loop.

    Attributes:
      agents: now.
      memory: of the behavior model.
      route: of the driven agent, N = 1.
      height: of the driven agent's center above the lane [m].
      touched: agents that overlap the driven one since the start; they are no collisions.
      number: of steps since the start.
    """

    agents: Agents
    memory: Any
    route: Routes
    height: Float[AnyArray, "*b"]
    touched: Bool[AnyArray, "*b N"]
    number: Int[AnyArray, "*b"]


class DrivingTerms(NamedTuple):
    """What a step meant for the driven agent; rewards and the end of an episode follow from it.

    Attributes:
      progress: distance along the route [m].
      collides: its box overlaps another one.
      off_road: its center is more than 3 m from every centerline.
      runs_red: its front passed a stop line at red.
      arrives: it has left the map at the end of its route.
      invalid_action: the action was not finite; the vehicle braked instead.
    """

    progress: Float[AnyArray, "*b"]
    collides: Bool[AnyArray, "*b"]
    off_road: Bool[AnyArray, "*b"]
    runs_red: Bool[AnyArray, "*b"]
    arrives: Bool[AnyArray, "*b"]
    invalid_action: Bool[AnyArray, "*b"]


def start_driving(
    key: Array,
    network: RoadNetwork,
    agents: Agents,
    places: LanePlaces,
    row: Int[AnyArray, ""],
    *,
    behavior: BehaviorModel,
    lanes: Int[AnyArray, " R"] | None = None,
) -> DrivingState:
    """The state at time 0, in which agent ``row`` is driven.

    Args:
      lanes: its route, if it has one to follow; -1 behind the end. By default it is drawn, straight on likelier.
    """
    keys = jax.random.split(key, NUM_LANES + 1)
    memory = behavior.start(keys[0], network, agents, places)
    first = jnp.full((1, NUM_LANES), NONE).at[0, 0].set(places.lane[row])
    one = jax.tree.map(lambda values: values[row][None], agents)
    zeros = jnp.zeros(1)
    along = (places.along[row] - AXLE_SHARE * agents.length[row])[None]
    route = Routes(lanes=first, along=along, lateral=zeros, lateral_speed=zeros, heading=zeros)
    if lanes is not None:
        route = route.replace(lanes=jnp.asarray(lanes, jnp.int32)[None])
    route = complete_routes(keys[1:], network, track_route(network, route, one))
    ground = way_points(network, route, jnp.full((1, 1), AXLE_SHARE) * one.length[:, None]).z[0, 0]
    return DrivingState(
        agents=agents,
        memory=behavior.with_route(memory, row, route),
        route=route,
        height=agents.z[row] - ground,
        touched=touching_bodies(agents, row),
        number=jnp.int32(0),
    )


def drive_step(
    key: Array,
    network: RoadNetwork,
    state: DrivingState,
    action: Action,
    signals: Int[AnyArray, " S"],
    row: Int[AnyArray, ""],
    *,
    behavior: BehaviorModel,
    dt: float,
) -> tuple[DrivingState, DrivingTerms]:
    """The state ``dt`` seconds later, and what happened to the driven agent.

    Args:
      signals: ``Signal`` of every signal at the start of the step.
    """
    move_key, route_key = jax.random.split(jax.random.fold_in(key, state.number))
    before = state.agents
    invalid = ~finite_action(action)
    action = Action(jnp.where(invalid, _RESTING, action.acceleration), jnp.where(invalid, 0.0, action.curvature))
    pose = VehiclePose(before.x[row], before.y[row], before.heading[row], before.speed[row])
    pose = bicycle_step(pose, action, dt)
    memory, moved = behavior.step(move_key, network, state.memory, before, signals, dt)
    is_row = jnp.arange(before.x.shape[0]) == row
    driven = {name: jnp.where(is_row, getattr(pose, name), getattr(moved, name)) for name in VehiclePose._fields}
    was_here = before.valid[row]
    agents = moved.replace(
        **driven,
        valid=jnp.where(is_row, was_here, moved.valid),
        entries=jnp.where(is_row, before.entries, moved.entries),
    )
    one = jax.tree.map(lambda values: values[row][None], agents)
    route = extend_routes(route_key, network, track_route(network, state.route, one))
    center = way_points(network, route, AXLE_SHARE * one.length[:, None])
    agents = agents.replace(z=jnp.where(is_row, center.z[0, 0] + state.height, agents.z))
    rest, ends = remaining(network, route)
    arrives = (ends & network.is_exit[route.last_lane] & (rest < AXLE_SHARE * one.length))[0] & was_here
    agents = agents.replace(valid=agents.valid & ~(is_row & arrives))
    touching = touching_bodies(agents, row)
    distance = jnp.sqrt(((network.x - pose.x) ** 2 + (network.y - pose.y) ** 2).min())
    terms = DrivingTerms(
        progress=jnp.where(was_here, _progress(before, agents, route, row), 0.0),
        collides=(touching & ~state.touched).any() & was_here,
        off_road=(distance > OFF_ROAD) & was_here,
        runs_red=_runs_red(network, state.route, before, pose, signals, row) & was_here,
        arrives=arrives,
        invalid_action=invalid & was_here,
    )
    after = state.replace(
        agents=agents,
        memory=behavior.with_route(memory, row, route),
        route=route,
        touched=state.touched & touching,
        number=state.number + 1,
    )
    return after, terms


def _progress(before: Agents, after: Agents, route: Routes, row: Int[AnyArray, ""]) -> Float[AnyArray, ""]:
    """Distance of the step along the direction of the route [m]."""
    angle = after.heading[row] - route.heading[0]
    return (after.x[row] - before.x[row]) * jnp.cos(angle) + (after.y[row] - before.y[row]) * jnp.sin(angle)


def _runs_red(
    network: RoadNetwork,
    route: Routes,
    before: Agents,
    pose: VehiclePose,
    signals: Int[AnyArray, " S"],
    row: Int[AnyArray, ""],
) -> Bool[AnyArray, ""]:
    """Whether the front of the agent passed the start of a lane of its route at red."""
    signal = network.signal[route.lanes[0]]
    is_red = (route.lanes[0] >= 0) & (signal >= 0) & (signals[signal] == Signal.STOP)
    ahead = lane_starts(network, route)[0, :-1] - route.along[0] - (0.5 + AXLE_SHARE) * before.length[row]
    moved = jnp.hypot(pose.x - before.x[row], pose.y - before.y[row])
    return (is_red & (ahead > 0) & (ahead <= moved)).any()
