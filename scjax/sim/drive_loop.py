"""The compiled loop of a driven agent, and what it gives."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Int

from scjax.scene import NO_EGO, Log, Map
from scjax.scene.scene import AnyArray
from scjax.sim.behavior import BehaviorModel
from scjax.sim.closed_loop import DrivingState, DrivingTerms, drive_step, start_driving
from scjax.sim.observation import observe
from scjax.sim.policies import Policy
from scjax.sim.preparation import Start
from scjax.sim.road_network import RoadNetwork
from scjax.sim.rollout import moving_fields


@dataclasses.dataclass(frozen=True)
class DriveResult:
    """A closed loop that has ended.

    Attributes:
      log: what happened.
      actor: id of the driven agent.
      terms: arrays [T] of each step, by the names of ``DrivingTerms``.
      map: the map as it has grown, if it grew.
    """

    log: Log
    actor: str
    terms: dict[str, np.ndarray]
    map: Map | None = None

    @property
    def progress(self) -> float:
        """Distance driven along the route [m]."""
        return float(self.terms["progress"].sum())


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


start_state = jax.jit(start_driving, static_argnames=("behavior",))
"""``start_driving``, compiled."""


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
