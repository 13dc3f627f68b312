"""Pedestrians: they keep their speed and heading, and stop before vehicles. Jitted, one scene."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Float

from scjax.scene import AgentType
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents

_MAX_SPEED = 2.0  # m/s; faster ones are errors of the source
_LOOK_AHEAD = 1.5  # m
_ROOM = 0.4  # m around bodies


def walk(agents: Agents, dt: float) -> Agents:
    """Everybody as if a pedestrian: the step ahead, unless a body that is no pedestrian is there or comes."""
    speed = jnp.minimum(agents.speed, _MAX_SPEED)
    free = ~_is_blocked(agents, _LOOK_AHEAD)
    distance = jnp.where(free, speed * dt, 0.0)
    return agents.replace(
        x=agents.x + distance * jnp.cos(agents.heading),
        y=agents.y + distance * jnp.sin(agents.heading),
        speed=speed,
    )


def _is_blocked(agents: Agents, ahead: float) -> Float[AnyArray, " N"]:
    """Whether a place ``ahead`` [m] of each agent lies on another body, or where it will be within a second."""
    x, y = agents.x + ahead * jnp.cos(agents.heading), agents.y + ahead * jnp.sin(agents.heading)
    cos, sin = jnp.cos(agents.heading), jnp.sin(agents.heading)
    reach = agents.speed * 1.0
    d_x = x[:, None] - (agents.x + 0.5 * reach * cos)[None]
    d_y = y[:, None] - (agents.y + 0.5 * reach * sin)[None]
    along, across = jnp.abs(d_x * cos[None] + d_y * sin[None]), jnp.abs(d_y * cos[None] - d_x * sin[None])
    inside = (along < (0.5 * (agents.length + reach) + _ROOM)[None]) & (across < (0.5 * agents.width + _ROOM)[None])
    counts = agents.valid & (agents.kind != AgentType.PEDESTRIAN)
    others = ~jnp.eye(agents.x.shape[0], dtype=bool)
    return (inside & counts[None] & others).any(1)
