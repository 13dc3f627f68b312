"""Masked dense attention, written for XLA:CPU: explicit [B H, T, d] products, division after the value product.

Two guarantees: a row without any admitted key yields exactly zero (value and gradient), and what stands at a masked
key never reaches a result, provided that it is finite (callers zero masked inputs before they project).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def split_heads(x: Float[Array, "b t hd"], heads: int) -> Float[Array, "b h t d"]:
    """Consecutive chunks of the width, one a head."""
    return x.reshape(*x.shape[:-1], heads, -1).swapaxes(-2, -3)


def merge_heads(x: Float[Array, "b h t d"]) -> Float[Array, "b t hd"]:
    """Inverse of ``split_heads``."""
    x = x.swapaxes(-2, -3)
    return x.reshape(*x.shape[:-2], -1)


def weights(logits: Float[Array, "b h q k"], mask: Bool[Array, "b 1 q_or_1 k"]) -> tuple[Array, Array]:
    """Unnormalised softmax weights and their sums, in at least float32.

    Returns:
      p [b, h, q, k], zero at masked keys; total [b, h, q, 1], 1 for rows without any key (so that p / total is 0).
    """
    logits = jnp.where(mask, logits.astype(jnp.promote_types(logits.dtype, jnp.float32)), -1e30)
    p = jnp.exp(logits - jax.lax.stop_gradient(logits.max(-1, keepdims=True)))
    p = jnp.where(mask, p, 0.0)
    total = p.sum(-1, keepdims=True)
    return p, jnp.where(total > 0, total, 1.0)


def attend(
    q: Float[Array, "b q hd"], k: Float[Array, "b k hd"], v: Float[Array, "b k hd"],
    mask: Bool[Array, "b q_or_1 k"], heads: int,
) -> Float[Array, "b q hd"]:  # fmt: skip
    """softmax(q k' / sqrt(d)) v over the admitted keys, heads concatenated.

    ``mask`` is True where query (or, with one row, every query) may read the key.
    """
    head_width = q.shape[-1] // heads
    queries, keys, values = (split_heads(x, heads) for x in (q, k, v))
    logits = jnp.einsum("bhqd,bhkd->bhqk", queries * head_width**-0.5, keys)
    p, total = weights(logits, mask[:, None])
    return merge_heads(jnp.einsum("bhqk,bhkd->bhqd", p.astype(values.dtype), values) / total.astype(values.dtype))
