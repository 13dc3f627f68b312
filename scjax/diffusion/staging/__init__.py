"""Staging: what is asked for by name, rare events and the ego's light, as cues that estimates are led to.

A network that has seen few of them gets an event nearly right: a pedestrian stops short of the lane, a queue keeps its
half metre from the middle on the wrong side, one lane of three shows another light. So on the lanes of an estimate a
place is looked for where an event can happen, with the agents that have least to change, and the lanes that the ego's
light is for; ``steering`` leads them there, while the network goes on to answer with the rest. Not in the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from scjax.data.captions.events import Event
from scjax.data.captions.facts import LIGHTS
from scjax.diffusion.staging.acts import ACTS
from scjax.diffusion.staging.lights import lanes_of_light
from scjax.diffusion.staging.spots import Poses, cross, given_to, left_of, look, nobody
from scjax.pytree import pytree
from scjax.scene import AnyArray, Scene, Signal

EVENTS: tuple[Event, ...] = get_args(Event)
ROUNDS, BELOW, LAST = 32, 0.7, 16
"""Gradient steps, as ``Steering.rounds``, from a noise at which an agent can still turn round; those of the last step,
where a place is a matter of decimetres."""

_PULL = 400.0  # m^2 of an agent's direction
_PACE = 2.0  # s^2
_WIDE = 8.0  # m; beyond that the pull grows no further
_SHOWN = 100.0  # m^2 of a light's cross-entropy


@pytree
class Wanted:
    """What scenes shall show: which of ``EVENTS``, and the ``Signal`` of the ego's light (UNKNOWN: any)."""

    events: Bool[AnyArray, "b events"]
    light: Int[AnyArray, " b"]


class Cues(NamedTuple):
    """Poses of agents, and the ``Signal`` that lanes shall show (UNKNOWN: as they like)."""

    poses: Poses
    signals: Int[Array, "b lanes"]


def wanted(wishes: Sequence[tuple[Sequence[str], str | None]]) -> Wanted:
    """Events and the light of each scene."""
    events = np.array([[event in named for event in EVENTS] for named, _ in wishes], bool)
    lights = [Signal.UNKNOWN if light is None else LIGHTS[light] for _, light in wishes]
    return Wanted(events=events, light=np.array(lights, np.int32))


def anything(wanted: Wanted) -> Bool[Array, " b"]:
    """Whether a scene shall show anything."""
    return jnp.asarray(wanted.events).any(1) | (jnp.asarray(wanted.light) != Signal.UNKNOWN)


def cues(scene: Scene, wanted: Wanted, made: Bool[AnyArray, "b agents"]) -> Cues:
    """Cues that make each scene show what it is asked for; where there is no room for an event, nobody has a part.

    Args:
      made: agents that may be led.
    """
    return jax.vmap(_cues)(scene, wanted, made)


def energy(scene: Scene, signal_logits: Float[AnyArray, "b lanes 4"] | None, cues: Cues) -> Float[Array, " b"]:
    """Half the squared distance from the poses [m^2], directions, speeds and lights counted as metres; summed."""
    agents, poses = jnp.asarray(scene.agents), cues.poses
    to = agents[..., :2] - poses.place
    apart = jnp.stack([(to * poses.ahead).sum(-1), cross(poses.ahead, to)], -1)
    off = jnp.square(jax.nn.relu(jnp.abs(apart) - poses.room)).sum(-1)
    turned = jnp.square(agents[..., 4:6] - _nearer(poses.ahead, agents[..., 4:6])).sum(-1)
    pace = jax.nn.relu(poses.slowest - agents[..., 3]) + jax.nn.relu(agents[..., 3] - poses.fastest)
    away = _WIDE**2 * (jnp.sqrt(1 + off / _WIDE**2) - 1) + 0.5 * (_PULL * turned + _PACE * jnp.square(pace))
    total = jnp.where(poses.meant, away, 0).sum(-1)
    if signal_logits is None:
        return total
    told = jnp.take_along_axis(jax.nn.log_softmax(jnp.asarray(signal_logits)), cues.signals[..., None], -1)[..., 0]
    return total - _SHOWN * jnp.where(cues.signals != Signal.UNKNOWN, told, 0).sum(-1)


def _cues(scene: Scene, wanted: Wanted, made: Bool[AnyArray, " agents"]) -> Cues:
    stage = look(scene, made)
    poses = nobody(stage.agents)
    for number, event in enumerate(EVENTS):
        found = ACTS[event](stage)
        poses = given_to(found.meant & wanted.events[number] & ~poses.meant, found, poses)  # who has a part keeps it
    lit = lanes_of_light(scene, stage)
    return Cues(poses, jnp.where(lit, wanted.light, Signal.UNKNOWN))


def _nearer(wanted: Float[Array, "b n 2"], ahead: Float[Array, "b n 2"]) -> Float[Array, "b n 2"]:
    """A direction, or a right angle towards it where it is further: nothing pulls who faces the other way round."""
    ahead = jax.lax.stop_gradient(ahead)
    side = jnp.where(cross(ahead, wanted) < 0, -1.0, 1.0)[..., None] * left_of(ahead)
    return jnp.where((ahead * wanted).sum(-1, keepdims=True) < 0, side, wanted)
