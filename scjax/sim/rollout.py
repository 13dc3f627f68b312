"""The roll-out: one scan over time, for a batch of scenes of one shape."""

from __future__ import annotations

import functools
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from scjax.nn.sharding import spread
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents, LanePlaces
from scjax.sim.behavior import BehaviorModel
from scjax.sim.road_network import RoadNetwork

T = TypeVar("T")


@functools.partial(jax.jit, static_argnames=("behavior", "dt"))
def roll_out(
    keys: Array,
    networks: RoadNetwork,
    agents: Agents,
    places: LanePlaces,
    signals: Int[AnyArray, "B T S"],
    *,
    behavior: BehaviorModel,
    dt: float,
) -> dict[str, AnyArray]:
    """What changes of the agents, at the T steps after the start: arrays [B, T, N]. Devices share the scenes.

    Args:
      keys: one for each of B scenes.
      networks, agents, places: with a leading axis of B scenes.
      signals: ``Signal`` of every signal at the start of each step.
    """
    batch = jax.vmap(functools.partial(_one, behavior, dt))
    return spread(batch, shared=0)(keys, networks, agents, places, signals)


def _one(
    behavior: BehaviorModel,
    dt: float,
    key: Array,
    network: RoadNetwork,
    agents: Agents,
    places: LanePlaces,
    signals: Int[AnyArray, "T S"],
) -> dict[str, AnyArray]:
    def step(carry, states):
        number, state, present = carry
        state, after = behavior.step(jax.random.fold_in(key, number), network, state, present, states, dt)
        return (number + 1, state, after), moving_fields(after)

    memory = behavior.start(jax.random.fold_in(key, 0), network, agents, places)
    _, steps = jax.lax.scan(step, (jnp.int32(1), memory, agents), signals)
    return steps


def moving_fields(agents: Agents) -> dict[str, AnyArray]:
    """What of agents changes over time."""
    names = ("x", "y", "z", "heading", "speed", "valid", "entries")
    return {name: getattr(agents, name) for name in names}


def stack_records(records: list[T]) -> T:
    """PyTrees of equal shapes as one with a leading axis."""
    return jax.tree.map(lambda *values: np.stack(values), *records)
