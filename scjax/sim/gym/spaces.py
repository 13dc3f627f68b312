"""Spaces of Gymnasium for driving: observations as a dictionary of boxes, actions in -1..1."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from jaxtyping import Array, Float

from scjax.scene import AgentType
from scjax.scene.scene import AnyArray
from scjax.sim.bicycle import MAX_ACCELERATION, MAX_CURVATURE, Action
from scjax.sim.observation import FAR, NUM_NEAREST, ROUTE_DISTANCES, Observation
from scjax.sim.policies import Policy

_PLACE, _SPEED, _SIZE = 1000.0, 100.0, 100.0  # m, m/s, m; what is beyond is clipped
_PI = 3.2  # rad; a little more, since angles of single precision are rounded
_SCALARS = ("speed", "lateral", "heading", "stop_distance")  # of shape [1] in boxes
_AGENT = ((-_PLACE, _PLACE),) * 2 + ((-1.0, 1.0),) * 2 + ((0.0, _SPEED), (0.0, _SIZE), (0.0, _SIZE))
_ROUTE = ((-_PLACE, _PLACE),) * 2 + ((0.0, _SPEED),)
_BOUNDS = {
    "speed": ((0.0, _SPEED),),
    "size": ((0.0, _SIZE),) * 2,
    "lateral": ((-_PLACE, _PLACE),),
    "heading": ((-_PI, _PI),),
    "route": (_ROUTE,) * len(ROUTE_DISTANCES),
    "route_mask": ((0, 1),) * len(ROUTE_DISTANCES),
    "stop_distance": ((0.0, FAR),),
    "agents": (_AGENT,) * NUM_NEAREST,
    "agent_types": ((0, max(AgentType)),) * NUM_NEAREST,
    "agent_mask": ((0, 1),) * NUM_NEAREST,
}
"""Field of ``Observation`` -> least and greatest value of each of its numbers."""


def observation_space() -> spaces.Space:
    """A dictionary with a finite box for each field of ``Observation``; masks and types are int8."""
    boxes = {}
    for field in dataclasses.fields(Observation):
        low, high = np.moveaxis(np.array(_BOUNDS[field.name]), -1, 0)
        kind = np.float32 if low.dtype.kind == "f" else np.int8
        boxes[field.name] = spaces.Box(low.astype(kind), high.astype(kind), dtype=kind)
    return spaces.Dict(boxes)


def action_space() -> spaces.Space:
    """Acceleration and curvature, each in -1..1; positive curvature turns left."""
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def scaled_action(action: Float[AnyArray, "*b 2"]) -> Action:
    """The action for numbers of ``action_space``: accelerations to 6 m/s^2 and curvatures to 0.3 1/m."""
    return Action(MAX_ACCELERATION * action[..., 0], MAX_CURVATURE * action[..., 1])


def boxed_action(action: Action) -> Float[AnyArray, "*b 2"]:
    """The numbers of ``action_space`` for an action of a ``Policy``, clipped."""
    values = (action.acceleration / MAX_ACCELERATION, action.curvature / MAX_CURVATURE)
    return jnp.clip(jnp.stack(values, -1), -1.0, 1.0)


def boxed_observation(observation: Observation) -> dict[str, Array]:
    """One observation as numbers inside the boxes of ``observation_space``; jitted."""
    boxes = {}
    for name, bounds in _BOUNDS.items():
        low, high = np.moveaxis(np.array(bounds), -1, 0)
        values = jnp.asarray(getattr(observation, name))
        kind = jnp.float32 if low.dtype.kind == "f" else jnp.int8
        values = values[None] if name in _SCALARS else values
        boxes[name] = jnp.clip(values.astype(kind), low.astype(kind), high.astype(kind))
    return boxes


def unboxed_observation(boxes: Mapping[str, AnyArray]) -> Observation:
    """What a ``Policy`` reads: the inverse of ``boxed_observation``, for one agent or a batch."""
    values = {name: jnp.asarray(boxes[name]) for name in _BOUNDS}
    values |= {name: values[name][..., 0] for name in _SCALARS}
    values |= {name: values[name].astype(bool) for name in ("route_mask", "agent_mask")}
    values["agent_types"] = values["agent_types"].astype(jnp.int32)
    return Observation(**values)


def policy_actions(policy: Policy, boxes: Mapping[str, AnyArray]) -> Float[AnyArray, "B 2"]:
    """Actions of a ``Policy`` without memory for a batch of observations."""
    actions, _ = jax.vmap(lambda one: policy(one, None))(unboxed_observation(boxes))
    return boxed_action(actions)
