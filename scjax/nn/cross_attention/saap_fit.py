"""Buckets and classifiers of a trained model, for ``saap`` (attention-variants §4.6): what "posthoc" needs.

One module at a time: of a denoiser, ``params["blocks"][i][stage]["cross"]``. Its traces give the inputs: ``cross_in``
of the stage, and ``ctx_lane`` or ``ctx_agent`` and ``ctx_mask`` of ``encode_condition``.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float

from scjax.nn.cross_attention.clusters import kmeans
from scjax.nn.functional import Functional, Params


def fit(
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
    """One module's parameters with centroids, a trained classifier and the flag that makes it sparse.

    Args:
      module, params: ``functional`` of a ``Saap``, and its parameters after training.
      x, x_mask: what enters ``attend`` in many scenes, over all diffusion steps, since queries depend on the step.
      context, mask: the condition tokens of these scenes.
      key: draws the batches.
      iterations: of k-means, over the keys of all scenes.
      steps, batch_size, learning_rate: of Adam; a batch is so many scenes.

    Returns:
      the parameters, and the classifier's loss at each step.
    """
    data = tuple(jnp.asarray(array) for array in (x, x_mask, context, mask))
    params = jax.tree.map(jnp.asarray, params)
    params = {**params, "centroids": centroids(module, params, *data[2:], iterations=iterations)}
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


def centroids(
    module: Functional, params: Params, context: Float[Array, "s m d"], mask: Bool[Array, "s m"], *, iterations: int
) -> Float[Array, "h c e"]:  # fmt: skip
    """Directions of each head's buckets: spherical k-means of the keys of all scenes together."""

    def run(params: Params) -> Array:
        keys = module.apply(params, module.apply(params, context, mask, method="project"), method="real_keys")
        together = keys.swapaxes(0, 1).reshape(1, keys.shape[1], -1, keys.shape[3])
        return kmeans(together, mask.reshape(1, -1), params["centroids"].shape[1], iterations)[0]

    return jax.jit(run)(params)
