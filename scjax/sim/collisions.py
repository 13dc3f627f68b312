"""Overlap of boxes on the ground. Jitted; for exact results on the host see ``scjax.scene.boxes``."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Bool, Int

from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents


def touching_bodies(agents: Agents, row: Int[AnyArray, ""]) -> Bool[AnyArray, " N"]:
    """Which other agents' boxes overlap that of agent ``row``: separating axis theorem."""
    cos, sin = jnp.cos(agents.heading), jnp.sin(agents.heading)
    d_x, d_y = agents.x - agents.x[row], agents.y - agents.y[row]
    half_length, half_width = 0.5 * agents.length, 0.5 * agents.width
    align = jnp.abs(cos * cos[row] + sin * sin[row])
    cross = jnp.abs(sin * cos[row] - cos * sin[row])

    def overlap(distance, own, other, other_side):
        return jnp.abs(distance) < own + other * align + other_side * cross

    is_near = overlap(d_x * cos[row] + d_y * sin[row], half_length[row], half_length, half_width)
    is_near &= overlap(d_y * cos[row] - d_x * sin[row], half_width[row], half_width, half_length)
    is_near &= overlap(d_x * cos + d_y * sin, half_length, half_length[row], half_width[row])
    is_near &= overlap(d_y * cos - d_x * sin, half_width, half_width[row], half_length[row])
    return is_near & agents.valid & (jnp.arange(agents.x.shape[0]) != row)
