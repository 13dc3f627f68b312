"""``scjax.drive``: a policy drives one agent through traffic that reacts to it."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from scjax.generate.arguments import sampling_key
from scjax.scene import NO_EGO, Log, Map, Scene
from scjax.scene.arguments import finite_number
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents, LanePlaces
from scjax.sim.behavior import BehaviorModel
from scjax.sim.closed_loop import DrivingState, DrivingTerms, drive_step, start_driving
from scjax.sim.observation import observe
from scjax.sim.policies import Policy, RoutePolicy
from scjax.sim.preparation import Start, prepare
from scjax.sim.road_network import RoadNetwork
from scjax.sim.rollout import moving_fields
from scjax.sim.route_follower import RouteFollower
from scjax.sim.simulate import MAX_SECONDS, TIME_STEP, key_seed, padded_signals
from scjax.sim.track_log import TrackLog


@dataclasses.dataclass(frozen=True)
class DriveResult:
    """A closed loop that has ended.

    Attributes:
      log: what happened.
      actor: id of the driven agent.
      terms: arrays [T] of each step, by the names of ``DrivingTerms``.
    """

    log: Log
    actor: str
    terms: dict[str, np.ndarray]

    @property
    def progress(self) -> float:
        """Distance driven along the route [m]."""
        return float(self.terms["progress"].sum())


def drive(
    key: Any,
    source: Log | Map | Scene,
    policy: Policy | None = None,
    *,
    policy_state: Any = None,
    seconds: float = 15.0,
    actor: str | None = None,
    behavior: BehaviorModel | None = None,
    step: int = 0,
) -> DriveResult:
    """A closed loop at 10 Hz: ``policy`` drives one agent, ``behavior`` moves all others.

    The driven agent moves as a kinematic bicycle (accelerations to 6 m/s^2, curvatures to 0.3 1/m). An action that is
    not finite brakes it.

    Args:
      key: a key of ``jax.random``, or a number.
      source: a scene, a map or a log.
      policy: (``Observation``, state) -> (``Action``, state), in JAX; ``RoutePolicy()`` by default.
      policy_state: memory of the policy at time 0, a PyTree.
      actor: id of the agent to drive; the ego, or the first vehicle on a lane without one.
      behavior: of all others; ``RouteFollower()`` by default.
      step: of a log, from which on it is simulated.

    Raises:
      ValueError: a time of 0 s, no lane that cars may use, no such actor, or an actor that is far from every lane.
    """
    seconds = finite_number(seconds, "seconds", TIME_STEP, MAX_SECONDS)
    steps = round(seconds / TIME_STEP)
    key = sampling_key(key)
    policy = RoutePolicy() if policy is None else policy
    behavior = RouteFollower() if behavior is None else behavior
    start = prepare(source, step, np.random.default_rng(key_seed(key)))
    row = actor_row(start, actor)
    signals = padded_signals([start], steps)[0]
    state = start_state(key, start.network, start.agents, start.places, jnp.int32(row), behavior=behavior)
    _, _, after, terms = drive_segment(
        key,
        start.network,
        state,
        signals,
        jnp.int32(row),
        policy_state,
        policy=policy,
        behavior=behavior,
        dt=TIME_STEP,
    )
    track, name = TrackLog(start), start.log.object_ids[row]
    shown = start.plan.states((1 + np.arange(steps)) * TIME_STEP)
    track.add(start, {name: np.asarray(values) for name, values in after.items()}, shown)
    return DriveResult(track.log(start.log, name, TIME_STEP), name, terms_on_host(terms))


def terms_on_host(terms: DrivingTerms) -> dict[str, np.ndarray]:
    """The terms by name, as NumPy arrays."""
    return {name: np.asarray(getattr(terms, name)) for name in DrivingTerms._fields}


def actor_row(start: Start, actor: str | None) -> int:
    """The row of the agent to drive.

    Raises:
      ValueError: there is no such agent, or it follows no lane.
    """
    lane = np.asarray(start.places.lane)[: start.log.num_objects]
    ids = start.log.object_ids
    if actor is None:
        if start.log.ego_index != NO_EGO:
            row = start.log.ego_index
        elif (lane >= 0).any():
            row = int(np.flatnonzero(lane >= 0)[0])
        else:
            raise ValueError("no agent follows a lane: add a vehicle on a lane, or name another source")
    elif actor in ids:
        row = ids.index(actor)
    else:
        raise ValueError(f"actor is {actor!r}: there is no such agent, only {', '.join(ids[:10]) or 'none'}")
    if lane[row] < 0:
        raise ValueError(
            f"actor {ids[row]!r} follows no lane: it is off the road, parked, or no vehicle; drive another one"
        )
    return row


@functools.partial(jax.jit, static_argnames=("behavior",))
def start_state(
    key: Array,
    network: RoadNetwork,
    agents: Agents,
    places: LanePlaces,
    row: Int[AnyArray, ""],
    lanes: Int[AnyArray, " R"] | None = None,
    *,
    behavior: BehaviorModel,
) -> DrivingState:
    """``start_driving``, jitted."""
    return start_driving(key, network, agents, places, row, behavior=behavior, lanes=lanes)


@functools.partial(jax.jit, static_argnames=("policy", "behavior", "dt"))
def drive_segment(
    key: Array,
    network: RoadNetwork,
    state: DrivingState,
    signals: Int[AnyArray, "T S"],
    row: Int[AnyArray, ""],
    policy_state: Any,
    *,
    policy: Policy,
    behavior: BehaviorModel,
    dt: float,
) -> tuple[DrivingState, Any, dict[str, AnyArray], DrivingTerms]:
    """State and memory of the policy after T steps; what changes of the agents, and the terms, at each."""

    def step(carry, states):
        state, memory = carry
        action, memory = policy(observe(network, state.agents, state.route, states, row), memory)
        state, terms = drive_step(key, network, state, action, states, row, behavior=behavior, dt=dt)
        return (state, memory), (moving_fields(state.agents), terms)

    (state, memory), (after, terms) = jax.lax.scan(step, (state, policy_state), signals)
    return state, memory, after, terms
