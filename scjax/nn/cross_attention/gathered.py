"""Attention in which every query reads its own keys, given by their indices; unread keys cost nothing."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from scjax.nn.attention import weights


def attend_gathered(
    q: Float[Array, "b h n d"],
    k: Float[Array, "b h m d"],
    v: Float[Array, "b h m d"],
    index: Int[Array, "b h n w"],
    mask: Bool[Array, "b h n w"],
) -> Float[Array, "b h n d"]:
    """softmax(q k' / sqrt(d)) v over the keys at ``index`` where ``mask`` is True; rows without keys give zero."""
    logits = jnp.einsum("bhnd,bhnwd->bhnw", q * q.shape[-1] ** -0.5, rows_at(k, index))
    p, total = weights(logits, mask)
    return jnp.einsum("bhnw,bhnwd->bhnd", (p / total).astype(v.dtype), rows_at(v, index))


def rows_at(x: Shaped[Array, "b h m d"], index: Int[Array, "b h *i"]) -> Shaped[Array, "b h *i d"]:
    """x[b, h, index[b, h]]."""
    return jax.vmap(jax.vmap(lambda rows, i: rows[i]))(x, index)


def first_of(
    selected: Bool[Array, "*b m"], size: int, score: Float[Array, "*b m"] | None = None
) -> tuple[Array, Array]:
    """The indices [*b, size] of the first (or the best, by ``score``) True entries, and which of them are real."""
    order = -selected.astype(jnp.int32) if score is None else jnp.where(selected, -score, jnp.inf)
    index = jnp.argsort(order, axis=-1, stable=True)[..., :size]
    return index, jnp.take_along_axis(selected, index, -1)
