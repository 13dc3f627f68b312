"""The one threshold of a trained model, for ``squeezed`` (attention-variants §4.9): what its rule "threshold" needs.

Inputs as in ``saap_fit``: the scores of every module together give the threshold of all.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from scjax.nn.cross_attention.base import readers
from scjax.nn.functional import Functional, Params, flatten, unflatten


def key_scores(
    module: Functional,
    params: Params,
    x: Float[Array | np.ndarray, "b n d"],
    x_mask: Bool[Array | np.ndarray, "b n"],
    context: Float[Array | np.ndarray, "b m d"],
    mask: Bool[Array | np.ndarray, "b m"],
) -> Float[np.ndarray, " scores"]:
    """The scores of all readable keys of one module: of every head and scene (and query, where they choose apart).

    Args:
      module, params: ``functional`` of a ``Squeezed``, and its parameters.
      x, x_mask: what enters ``attend``; context, mask: the condition tokens.
    """
    params = {**params, "threshold": jnp.zeros_like(params["threshold"])}  # at -1 nothing is clustered

    @jax.jit
    def run(params: Params, x: Array, x_mask: Array, context: Array, mask: Array) -> tuple[Array, Array]:
        cache = module.apply(params, context, mask, method="encode")
        query, rows = module.apply(params, x, x_mask, method="query"), readers(x_mask, mask)
        scores = module.apply(params, query, rows, cache, method="scores")
        real = mask[:, None, None] & (
            rows[:, None, :, None] if scores.shape[2] > 1 else rows.any(-1)[:, None, None, None]
        )
        return scores, jnp.broadcast_to(real, scores.shape)

    scores, real = run(params, *(jnp.asarray(array) for array in (x, x_mask, context, mask)))
    return np.asarray(scores)[np.asarray(real)]


def threshold_of(scores: Sequence[Float[np.ndarray, " scores"]], keep: float) -> float:
    """The score that a share ``keep`` of all keys exceeds: one for all modules, heads, scenes and diffusion steps."""
    return float(np.quantile(np.concatenate(scores), 1 - keep))


def with_threshold(params: Params, threshold: float) -> Params:
    """``params`` of a module or a whole denoiser with this threshold everywhere."""
    leaves = flatten(params)
    return unflatten(
        {path: jnp.full_like(leaf, threshold) if path[-1] == "threshold" else leaf for path, leaf in leaves.items()}
    )
