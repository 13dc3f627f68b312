"""Closed loops side by side in one jitted step; each slot has a source, a seed and a state of its own."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

from scjax.scene import Log, Map, Scene
from scjax.scene.arguments import finite_number
from scjax.scene.geometry import wrap_angle
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents, LanePlaces
from scjax.sim.behavior import BehaviorModel
from scjax.sim.behaviors import as_behavior
from scjax.sim.closed_loop import DrivingState, DrivingTerms, drive_step, start_driving
from scjax.sim.drive_loop import actor_row
from scjax.sim.gym.spaces import boxed_observation, scaled_action
from scjax.sim.observation import observe
from scjax.sim.preparation import pad_start, prepare
from scjax.sim.road_network import RoadNetwork
from scjax.sim.rollout import moving_fields, stack_records
from scjax.sim.simulate import MAX_SECONDS, TIME_STEP, padded_signals
from scjax.sim.track_log import TrackLog

DrivingSource = Log | Map | Scene

_MOMENTS = 64  # signals are padded to multiples: episodes of other lengths are no further program


@pytree
class SourceTable(Replaceable):
    """K sources of one padded shape.

    Attributes:
      network, agents, places: at the start, with a leading axis K.
      signals: ``Signal`` of every signal at T moments.
      row: of the agent to drive.
    """

    network: RoadNetwork
    agents: Agents
    places: LanePlaces
    signals: Int[AnyArray, "K T S"]
    row: Int[AnyArray, " K"]


@pytree
class LoopSlots(Replaceable):
    """B closed loops.

    Attributes:
      source: row of each in the table.
      seed: of the traffic.
      network: that of the source; a copy, so that a step gathers nothing.
      state: now.
    """

    source: Int[AnyArray, " B"]
    seed: UInt32[AnyArray, " B"]
    network: RoadNetwork
    state: DrivingState


class EpisodeBatch:
    """``count`` closed loops over prepared sources.

    Args:
      sources: one or several.
      count: number of slots B.
      seconds: length of an episode.
      actor: id of the agent to drive in every source; the ego, or the first vehicle on a lane without one.
      behavior: of all others: a model or its name; ``RouteFollower()`` by default.

    Raises:
      ValueError: no source, a time of 0 s, a source without a lane for cars, or an actor that follows no lane.
    """

    def __init__(
        self,
        sources: DrivingSource | Sequence[DrivingSource],
        count: int,
        *,
        seconds: float,
        actor: str | None,
        behavior: BehaviorModel | str | None,
    ):
        sources = list(sources) if isinstance(sources, Sequence) else [sources]
        if not sources:
            raise ValueError("sources is empty: give at least one scene, map or log")
        self.steps = round(finite_number(seconds, "seconds", TIME_STEP, MAX_SECONDS) / TIME_STEP)
        self.behavior = as_behavior(behavior)
        starts, rows = [], []
        for place, source in enumerate(sources):
            try:
                starts.append(prepare(source, 0, np.random.default_rng(place)))
                rows.append(actor_row(starts[-1], actor))
            except ValueError as error:
                raise ValueError(f"source {place}: {error}") from error
        shape = tuple(max(sizes) for sizes in zip(*(start.shape for start in starts), strict=True))
        self.starts = [pad_start(start, shape) for start in starts]
        parts = ("network", "agents", "places")
        stacks = {name: stack_records([getattr(start, name) for start in self.starts]) for name in parts}
        moments = -(-(self.steps + 1) // _MOMENTS) * _MOMENTS
        signals = padded_signals(self.starts, moments)
        self._table: SourceTable = jax.device_put(SourceTable(**stacks, signals=signals, row=np.array(rows, np.int32)))
        self._slots = _empty_slots(self._table, count, self.behavior)
        self.number = np.zeros(count, int)
        self.source = np.zeros(count, int)

    def begin(self, slot: int, source: int, seed: int) -> None:
        """Starts an episode in a slot. The same source and seed give the same one in every slot."""
        arguments = (np.int32(slot), np.int32(source), np.uint32(seed))
        self._slots = _begin(self._table, self._slots, *arguments, behavior=self.behavior)
        self.number[slot], self.source[slot] = 0, source

    def observe(self) -> dict[str, np.ndarray]:
        """New arrays of what the driven agents see, in the boxes of ``observation_space``, [B, ...]."""
        return {name: np.array(values) for name, values in _observe(self._table, self._slots).items()}

    def advance(self, actions: Float[np.ndarray, "B 2"], moves: np.ndarray) -> dict[str, np.ndarray]:
        """One step of every slot; the fields of ``DrivingTerms``, acceleration and lateral acceleration [m/s^2].

        Args:
          actions: numbers of ``action_space``. One that is not finite brakes.
          moves: False where a slot stays as it is.
        """
        arguments = (self._slots, actions.astype(np.float32), np.asarray(moves, bool))
        self._slots, terms = _advance(self._table, *arguments, behavior=self.behavior, dt=TIME_STEP)
        self.number += moves
        return {name: np.asarray(values) for name, values in terms.items()}

    def log(self, slot: int) -> Log:
        """The present moment of a slot as a log of one step; the driven agent is the ego."""
        start = self.starts[self.source[slot]]
        agents = self._slots.state.agents
        now = {name: np.asarray(values[slot])[None] for name, values in moving_fields(agents).items()}
        time = np.array([self.number[slot] * TIME_STEP])
        track = TrackLog(start)
        track.add(start, now, start.plan.states(time))
        actor = start.log.object_ids[int(self._table.row[self.source[slot]])]
        return dataclasses.replace(track.log(start.log, actor, TIME_STEP).select_steps([1]), timestamps=time)


def _empty_slots(table: SourceTable, count: int, behavior: BehaviorModel) -> LoopSlots:
    """Slots of zeros, in which no episode has begun."""
    shapes = jax.eval_shape(functools.partial(_loop, behavior=behavior), table, np.int32(0), np.uint32(0))
    return jax.tree.map(lambda one: jnp.zeros((count, *one.shape), one.dtype), shapes)


@functools.partial(jax.jit, static_argnames=("behavior",), donate_argnums=(1,))
def _begin(
    table: SourceTable, slots: LoopSlots, slot: AnyArray, source: AnyArray, seed: AnyArray, *, behavior: BehaviorModel
) -> LoopSlots:
    one = _loop(table, source, seed, behavior)
    return jax.tree.map(lambda all, new: all.at[slot].set(new), slots, one)


def _loop(table: SourceTable, source: AnyArray, seed: AnyArray, behavior: BehaviorModel) -> LoopSlots:
    """One loop at its start, without a leading axis."""
    network, agents, places = jax.tree.map(lambda values: values[source], (table.network, table.agents, table.places))
    state = start_driving(jax.random.key(seed), network, agents, places, table.row[source], behavior=behavior)
    return LoopSlots(source=source, seed=seed, network=network, state=state)


@jax.jit
def _observe(table: SourceTable, slots: LoopSlots) -> dict[str, Array]:
    def one(slot: LoopSlots):
        state = slot.state
        signals = table.signals[slot.source, state.number]
        seen = observe(slot.network, state.agents, state.route, signals, table.row[slot.source])
        return boxed_observation(seen)

    return jax.vmap(one)(slots)


@functools.partial(jax.jit, static_argnames=("behavior", "dt"), donate_argnums=(1,))
def _advance(
    table: SourceTable, slots: LoopSlots, actions: AnyArray, moves: AnyArray, *, behavior: BehaviorModel, dt: float
) -> tuple[LoopSlots, Mapping[str, Array]]:
    def one(slot: LoopSlots, action, does_move):
        before, row = slot.state, table.row[slot.source]
        signals = table.signals[slot.source, before.number]
        key = jax.random.key(slot.seed)
        after, terms = drive_step(
            key, slot.network, before, scaled_action(action), signals, row, behavior=behavior, dt=dt
        )
        turn = wrap_angle(after.agents.heading[row] - before.agents.heading[row])
        named = {name: getattr(terms, name) for name in DrivingTerms._fields}
        named["acceleration"] = (after.agents.speed[row] - before.agents.speed[row]) / dt
        named["lateral_acceleration"] = after.agents.speed[row] * turn / dt
        state = jax.tree.map(lambda new, old: jnp.where(does_move, new, old), after, before)
        return slot.replace(state=state), named

    return jax.vmap(one)(slots, actions, moves)
