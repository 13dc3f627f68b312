"""Attention over a long context in chunks of keys, without the whole table of scores (online softmax).

Milakov & Gimelshein 2018 (arXiv:1805.02867): the running sum and result are rescaled whenever a larger logit appears.
The backward pass recomputes each chunk's scores.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def attend_chunked(
    q: Float[Array, "b h n d"],
    k: Float[Array, "b h m d"],
    v: Float[Array, "b h m d"],
    mask: Bool[Array, "b m"],
    size: int,
) -> Float[Array, "b h n d"]:
    """As ``attention.attend_heads`` with one mask for all queries, ``size`` keys at a time (the last may be fewer)."""
    shape, heads = q.shape, q.shape[1]
    queries, keys, values = (x.reshape(-1, *x.shape[2:]) for x in (q * q.shape[-1] ** -0.5, k, v))
    readable = jnp.repeat(mask[:, None], heads, 0)
    dtype = jnp.promote_types(q.dtype, jnp.float32)

    @jax.checkpoint
    def step(state: tuple[Array, Array, Array], k: Array, v: Array, readable: Array) -> tuple[Array, Array, Array]:
        largest, total, attended = state
        logits = jnp.where(readable, (queries @ k.swapaxes(1, 2)).astype(dtype), -1e30)
        bound = jnp.maximum(largest, jax.lax.stop_gradient(logits.max(-1, keepdims=True)))
        shrink, p = jnp.exp(largest - bound), jnp.exp(logits - bound)
        attended = shrink * attended + (p.astype(v.dtype) @ v).astype(dtype)
        return bound, shrink * total + p.sum(-1, keepdims=True), attended

    # The first bound lies above the fill of masked keys, so that their weights underflow to exactly zero.
    rows = (*queries.shape[:2], 1)
    state = jnp.full(rows, -1e29, dtype), jnp.zeros(rows, dtype), jnp.zeros(queries.shape, dtype)
    for start in range(0, k.shape[2], size):  # not a scan: XLA counts the operations of its body once
        part = slice(start, start + size)
        state = step(state, keys[:, part], values[:, part], readable[..., part])
    _, total, attended = state
    return (attended / jnp.where(total > 0, total, 1.0)).astype(v.dtype).reshape(shape)
