"""Exponential moving average of parameters with a warm-up of its decay (official-spec §6)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from scjax.nn.functional import Params


def update_ema(ema: Params, params: Params, updates: Int[Array, ""] | int, decay: float) -> Params:
    """ema - (1 - d)(ema - params), d = min(decay, (1 + n) / (10 + n)).

    Args:
      ema: the average so far; the initial parameters at first.
      updates: n, the number of optimizer updates including the one that made ``params`` (1 at first).
    """
    n = jnp.asarray(updates, jnp.float32)
    keep = jnp.minimum(decay, (1 + n) / (10 + n))
    return jax.tree.map(lambda average, p: average - (1 - keep).astype(p.dtype) * (average - p), ema, params)
