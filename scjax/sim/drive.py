"""``scjax.drive``: a policy drives one agent through traffic that reacts to it."""

from __future__ import annotations

import collections
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

from scjax.generate.arguments import sampling_key
from scjax.generate.conditions import Condition
from scjax.scene import Log, Map, Scene
from scjax.scene.arguments import finite_number
from scjax.sim.behavior import BehaviorModel
from scjax.sim.behaviors import as_behavior
from scjax.sim.drive_loop import DriveResult, actor_row, drive_segment, start_state, terms_on_host
from scjax.sim.growing import GrowingDrive
from scjax.sim.policies import Policy, RoutePolicy
from scjax.sim.preparation import prepare
from scjax.sim.simulate import MAX_SECONDS, TIME_STEP, key_seed, padded_signals
from scjax.sim.track_log import TrackLog


def drive(
    key: Any,
    source: Log | Map | Scene,
    policy: Policy | None = None,
    *,
    policy_state: Any = None,
    seconds: float = 15.0,
    actor: str | None = None,
    behavior: BehaviorModel | str | None = None,
    step: int = 0,
    grow: Condition | str | None = None,
    **outpainting: Any,
) -> DriveResult:
    """A closed loop at 10 Hz: ``policy`` drives one agent, ``behavior`` moves all others.

    The driven agent moves as a kinematic bicycle (accelerations to 6 m/s^2, curvatures to 0.3 1/m). An action that is
    not finite brakes it.

    With ``grow`` a scene or map grows by tiles whenever less than 110 m of the way are left. A tile beyond which no
    road goes on is drawn again; where that does not help, tiles farther than 60 m from the driven agent are taken back.
    Agents of new tiles join the traffic, without vehicles and obstacles that stand in the way, and without who comes so
    near to others that braking does not help. Agents farther than 160 m are gone, and nobody enters at the border. Who
    has stood for 40 s in a junction, or as the first of a queue, is gone, too. The driven agent follows the route of
    the map, and the loop ends early where no road goes on.

    Args:
      key: a key of ``jax.random``, or a number.
      source: a scene, a map or a log.
      policy: (``Observation``, state) -> (``Action``, state), in JAX; ``RoutePolicy()`` by default.
      policy_state: memory of the policy at time 0, a PyTree.
      actor: id of the agent to drive; the ego, or the first vehicle on a lane without one.
      behavior: of all others: a model, or one of the names in ``BEHAVIORS``; ``RouteFollower()`` by default.
      step: of a log, from which on it is simulated.
      grow: what new tiles show; "" for whatever fits.
      outpainting: further options of ``scjax.outpaint`` for a map that grows, such as ``candidates`` and ``route``.

    Raises:
      ValueError: a time of 0 s, no lane that cars may use, no such actor, an actor that is far from every lane, or a
        log that shall grow.
    """
    seconds = finite_number(seconds, "seconds", TIME_STEP, MAX_SECONDS)
    policy = RoutePolicy() if policy is None else policy
    behavior = as_behavior(behavior)
    if grow is not None:
        options = {"policy_state": policy_state, "actor": actor, **outpainting}
        if isinstance(source, Log):
            raise ValueError("a log does not grow: give a scene or a map, such as log_to_map(log)")
        steps = drive_steps(key, source, policy, behavior=behavior, seconds=seconds, grow=grow, **options)
        return collections.deque(steps, maxlen=1)[0]
    if outpainting:
        raise ValueError(f"{next(iter(outpainting))} is an option of maps that grow: give grow too, or leave it out")
    steps, key = round(seconds / TIME_STEP), sampling_key(key)
    start = prepare(source, step, np.random.default_rng(key_seed(key)))
    row = actor_row(start, actor)
    state = start_state(key, start.network, start.agents, start.places, jnp.int32(row), behavior=behavior)
    _, _, after, terms = drive_segment(
        key,
        start.network,
        state,
        padded_signals([start], steps)[0],
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


def drive_steps(
    key: Any,
    source: Map | Scene,
    policy: Policy,
    *,
    behavior: BehaviorModel,
    seconds: float,
    grow: Condition | str,
    policy_state: Any = None,
    actor: str | None = None,
    **outpainting: Any,
) -> Iterator[DriveResult]:
    """``drive`` on a map that grows: what has happened so far, every two seconds. Arguments as there."""
    run = GrowingDrive(
        sampling_key(key),
        source,
        policy,
        condition=grow or None,
        policy_state=policy_state,
        behavior=behavior,
        actor=actor,
        **outpainting,
    )
    for _ in run.segments(round(seconds / TIME_STEP)):
        yield run.result()
