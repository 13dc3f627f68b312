"""The paper's collision penalty (L_col), as it is meant (official-spec §7): the release reads the wrong columns, turns
the wrong way, sums over the batch, and lets the frozen decoder drift. Here: columns of the scene type, the transpose of
the rotation, means over scenes, and a decoder that stays as it is.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from scjax.diffusion.noise_level import NoiseLevel

TAU = 0.1


def collision_penalty(
    agents: Float[Array, "b n 9"], counted: Bool[Array, "b n"], *, tau: float = TAU
) -> Float[Array, " b"]:
    """How much boxes overlap, one number a scene: sum over ordered pairs of tanh(overlap / tau), over 2 n.

    The overlap of a pair is measured in the frame of the first box as if both had its heading, and divided by the sum
    of their areas. Only centres receive gradients, and not that of the ego.

    Args:
      agents: the nine columns of ``Scene.agents``; the ego first.
      counted: agents that take part (vehicles).
    """
    places = jnp.concatenate([jax.lax.stop_gradient(agents[:, :1, :2]), agents[:, 1:, :2]], 1)
    cos, sin, length, width = jnp.moveaxis(jax.lax.stop_gradient(agents[..., 4:8]), -1, 0)
    to = places[:, None] - places[:, :, None]  # from the first (row) to the second (column)
    ahead = cos[..., None] * to[..., 0] + sin[..., None] * to[..., 1]
    aside = cos[..., None] * to[..., 1] - sin[..., None] * to[..., 0]
    deep = jax.nn.relu((length[:, :, None] + length[:, None]) / 2 - jnp.abs(ahead))
    deep = deep * jax.nn.relu((width[:, :, None] + width[:, None]) / 2 - jnp.abs(aside))
    area = length * width
    share = deep / (area[:, :, None] + area[:, None] + 1e-6)
    pairs = counted[:, :, None] & counted[:, None] & ~jnp.eye(agents.shape[1], dtype=bool)[None]
    total = jnp.where(pairs, jnp.tanh(share / tau), 0.0).sum((1, 2))
    return total / (2 * jnp.maximum(counted.sum(-1), 1))


def noise_weight(level: NoiseLevel) -> Float[Array, " b"]:
    """1 - noise, i.e. 1 - sqrt(1 - abar_t): near 1 where x_0 is nearly known, near 0 where it is a guess."""
    return 1 - jnp.asarray(level.noise)
