"""Masked dense attention: explicit [B H, T, d] products and division after the value product, fast on XLA:CPU.

Two guarantees: a row without any admitted key yields exactly zero (value and gradient), and finite values at masked
keys never reach a result (callers zero masked inputs before they project).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from einops import rearrange
from jaxtyping import Array, Bool, Float

from scjax.nn.cpu.backend import attention_parts


def split_heads(x: Float[Array, "b t hd"], heads: int) -> Float[Array, "b h t d"]:
    """Splits the width into consecutive chunks, one per head."""
    return rearrange(x, "... t (h d) -> ... h t d", h=heads)


def merge_heads(x: Float[Array, "b h t d"]) -> Float[Array, "b t hd"]:
    """Inverse of ``split_heads``."""
    return rearrange(x, "... h t d -> ... t (h d)")


def weights(logits: Float[Array, "*b k"], mask: Bool[Array, "*#b #k"]) -> tuple[Array, Array]:
    """Unnormalized softmax weights and their sums, in at least float32.

    Returns:
      p [*b, k], zero at masked keys; total [*b, 1], 1 for rows without any key (so that p / total is 0).
    """
    logits = jnp.where(mask, logits.astype(jnp.promote_types(logits.dtype, jnp.float32)), -1e30)
    p = jnp.exp(logits - jax.lax.stop_gradient(logits.max(-1, keepdims=True)))
    p = jnp.where(mask, p, 0.0)
    total = p.sum(-1, keepdims=True)
    return p, jnp.where(total > 0, total, 1.0)


def attend(
    q: Float[Array, "b q hd"],
    k: Float[Array, "b k hd"],
    v: Float[Array, "b k hd"],
    mask: Bool[Array, "b q_or_1 k"] | None,
    heads: int,
) -> Float[Array, "b q hd"]:
    """softmax(q k' / sqrt(d)) v over the admitted keys, heads concatenated.

    ``mask`` is True where the query (or, with one row, every query) may read the key; None admits every key.
    """
    return merge_heads(attend_heads(split_heads(q, heads), split_heads(k, heads), split_heads(v, heads), mask))


def attend_heads(
    q: Float[Array, "b h q d"],
    k: Float[Array, "b h k d"],
    v: Float[Array, "b h k d"],
    mask: Bool[Array, "b q_or_1 k"] | Bool[Array, "b h q_or_1 k"] | None,
) -> Float[Array, "b h q d"]:
    """As ``attend``, with separate heads; the mask may differ between heads."""
    if mask is None:
        mask = jnp.ones((len(q), 1, k.shape[2]), bool)

    def attend_scenes(arrays: tuple[Array, Array, Array, Array]) -> Array:
        q, k, v, mask = arrays
        heads, scale = q.shape[1], q.shape[-1] ** -0.5
        queries, keys, values = (x.reshape(-1, *x.shape[2:]) for x in (q, k, v))
        rows = jnp.repeat(mask, heads, 0) if mask.ndim == 3 else mask.reshape(-1, *mask.shape[2:])
        return _attend(queries * scale, keys, values, rows).reshape(q.shape)

    arrays = (q, k, v, mask)
    parts = attention_parts(len(q), q.shape[1] * q.shape[2] * k.shape[2])
    if parts == 1:
        return attend_scenes(arrays)
    split = tuple(x.reshape(parts, -1, *x.shape[1:]) for x in arrays)
    return jax.lax.map(jax.checkpoint(attend_scenes), split).reshape(q.shape)


def _attend(
    q: Float[Array, "n q d"], k: Float[Array, "n k d"], v: Float[Array, "n k d"], mask: Bool[Array, "n q_or_1 k"]
) -> Float[Array, "n q d"]:
    """Attention of one head per row, with scaled queries. The softmax is in at least float32."""
    logits = q @ k.swapaxes(1, 2)
    logits = jnp.where(mask, logits.astype(jnp.promote_types(logits.dtype, jnp.float32)), -1e30)
    # Rows without any key: the bound above the fill makes their weights underflow to exactly zero.
    largest = jnp.maximum(jax.lax.stop_gradient(logits.max(-1, keepdims=True)), -1e29)
    p = jnp.exp(logits - largest)
    total = p.sum(-1, keepdims=True)
    return (p.astype(v.dtype) @ v) / jnp.where(total > 0, total, 1.0).astype(v.dtype)
