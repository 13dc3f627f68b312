"""Calibration of the sparse mechanisms on a trained model: ``saap`` and ``squeezed`` (attention-variants §4.6, §4.9).

``fit_saap`` finds a module's buckets and trains its router (mode "posthoc"). ``key_scores``, ``score_threshold`` and
``with_threshold`` find the one threshold of a model (``squeezed``, rule "threshold").

Of a denoiser, one module's parameters are ``params["blocks"][i][stage]["cross"]``. Traces of the denoiser hold the
inputs: ``cross_in`` of the stage; ``ctx_lane`` or ``ctx_agent``, and ``ctx_mask``, of ``encode_condition``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from einops import rearrange
from jaxtyping import Array, Bool, Float

from scjax.nn.cross_attention.base import active_rows
from scjax.nn.cross_attention.clusters import kmeans
from scjax.nn.functional import Functional, Params, flatten, unflatten


def fit_saap(
    module: Functional,
    params: Params,
    x: Float[Array | np.ndarray, "s n d"],
    x_mask: Bool[Array | np.ndarray, "s n"],
    context: Float[Array | np.ndarray, "s m d"],
    mask: Bool[Array | np.ndarray, "s m"],
    key: Array,
    *,
    iterations: int = 20,
    steps: int = 3000,
    batch_size: int = 32,
    learning_rate: float = 1e-3,
) -> tuple[Params, Float[Array, " steps"]]:
    """One module's parameters with centroids, a trained router and the flag that makes it sparse.

    Args:
      module, params: ``functional`` of a ``Saap``, and its parameters after training.
      x, x_mask: inputs of ``attend`` for many scenes and all diffusion steps, since queries depend on the step.
      context, mask: the context tokens of these scenes.
      key: random key for the batches.
      iterations: iterations of k-means over the keys of all scenes.
      steps, batch_size, learning_rate: of Adam; the batch size counts scenes.

    Returns:
      the parameters, and the router's loss at each step.
    """
    data = tuple(jnp.asarray(array) for array in (x, x_mask, context, mask))
    params = jax.tree.map(jnp.asarray, params)
    params = {**params, "centroids": _centroids(module, params, *data[2:], iterations=iterations)}
    adam = optax.adam(learning_rate)

    def loss(router: Params, rows: Array) -> Array:
        return module.apply({**params, "router": router}, *(array[rows] for array in data), method="routing_loss")

    def step(state: tuple[Any, optax.OptState], number: Array) -> tuple[tuple[Any, optax.OptState], Array]:
        router, moments = state
        rows = jax.random.randint(jax.random.fold_in(key, number), (min(batch_size, len(data[0])),), 0, len(data[0]))
        value, gradient = jax.value_and_grad(loss)(router, rows)
        updates, moments = adam.update(gradient, moments)
        return (optax.apply_updates(router, updates), moments), value

    start = params["router"], adam.init(params["router"])
    (router, _), losses = jax.jit(lambda state: jax.lax.scan(step, state, jnp.arange(steps)))(start)
    return {**params, "router": router, "fitted": jnp.ones_like(params["fitted"])}, losses


def _centroids(
    module: Functional, params: Params, context: Float[Array, "s m d"], mask: Bool[Array, "s m"], *, iterations: int
) -> Float[Array, "h c e"]:
    """Directions of each head's buckets: spherical k-means of the keys of all scenes together."""

    def run(params: Params) -> Array:
        keys = module.apply(params, module.apply(params, context, mask, method="project"), method="real_keys")
        all_keys = rearrange(keys, "s h m d -> 1 h (s m) d")
        return kmeans(all_keys, mask.reshape(1, -1), params["centroids"].shape[1], iterations)[0]

    return jax.jit(run)(params)


def key_scores(
    module: Functional,
    params: Params,
    x: Float[Array | np.ndarray, "b n d"],
    x_mask: Bool[Array | np.ndarray, "b n"],
    context: Float[Array | np.ndarray, "b m d"],
    mask: Bool[Array | np.ndarray, "b m"],
) -> Float[np.ndarray, " scores"]:
    """Scores of all readable keys of one module, over heads and scenes (and queries, where each query selects).

    Args:
      module, params: ``functional`` of a ``Squeezed``, and its parameters.
      x, x_mask: inputs of ``attend``.
      context, mask: the context tokens.
    """
    params = {**params, "threshold": jnp.zeros_like(params["threshold"])}  # at -1 nothing is clustered

    @jax.jit
    def run(params: Params, x: Array, x_mask: Array, context: Array, mask: Array) -> tuple[Array, Array]:
        cache = module.apply(params, context, mask, method="encode")
        query, rows = module.apply(params, x, x_mask, method="query"), active_rows(x_mask, mask)
        scores = module.apply(params, query, rows, cache, method="scores")
        real = mask[:, None, None] & (
            rows[:, None, :, None] if scores.shape[2] > 1 else rows.any(-1)[:, None, None, None]
        )
        return scores, jnp.broadcast_to(real, scores.shape)

    scores, real = run(params, *(jnp.asarray(array) for array in (x, x_mask, context, mask)))
    return np.asarray(scores)[np.asarray(real)]


def score_threshold(scores: Sequence[Float[np.ndarray, " scores"]], keep: float) -> float:
    """The score that a share ``keep`` of all keys exceeds, for all modules, heads, scenes and diffusion steps."""
    return float(np.quantile(np.concatenate(scores), 1 - keep))


def with_threshold(params: Params, threshold: float) -> Params:
    """``params`` of a module or a whole denoiser, with this threshold in every module."""
    leaves = flatten(params)
    return unflatten(
        {path: jnp.full_like(leaf, threshold) if path[-1] == "threshold" else leaf for path, leaf in leaves.items()}
    )
