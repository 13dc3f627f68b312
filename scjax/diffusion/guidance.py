"""Classifier-free guidance as a wrapper around one ``denoise(z, t)``: both branches in one batch (spec §5.3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from scjax.models.nodes import Nodes

Denoise = Callable[[Nodes, Int[Array, " b"]], Nodes]
T = TypeVar("T")


def join(conditional: T, unconditional: T) -> T:
    """Two PyTrees of batches -> one of twice the batch, the conditional half first."""
    return jax.tree.map(lambda c, u: jnp.concatenate([c, u]), conditional, unconditional)


def guided(denoise_both: Denoise, weight: float | Float[Array, "*b"]) -> Denoise:
    """eps_u + w (eps_c - eps_u); w = 1 is the conditional estimate, 4 the official choice.

    Args:
      denoise_both: estimate of a batch of 2 B whose first half is conditional (see ``join``).
      weight: w, or one a scene [B].
    """

    def denoise(z: Nodes, t: Int[Array, " b"]) -> Nodes:
        eps = denoise_both(join(z, z), jnp.concatenate([t, t]))
        w = jnp.broadcast_to(jnp.asarray(weight), t.shape)[:, None, None]

        def combine(both: Array) -> Array:
            conditional, unconditional = jnp.split(both, 2)
            return unconditional + w.astype(both.dtype) * (conditional - unconditional)

        return jax.tree.map(combine, eps)

    return denoise
