"""Outputs of the encoder and the decoder."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Array, Float

from scjax.nn import random
from scjax.scene.per_type import PerType
from scjax.scene.pytree import pytree


@pytree
class Posterior:
    """Diagonal Gaussians over the latents; rows of padding are zero.

    Attributes:
      mean, logvar: ``PerType`` of [B, A, agent_latent] and [B, L, lane_latent]; logvar is not clipped.
      lane_count_logits: for the number of lanes at x > 0 of a partitioned scene, classes 0..max_lanes.
    """

    mean: PerType
    logvar: PerType
    lane_count_logits: Float[Array | np.ndarray, "b classes"]


@pytree
class Decoded:
    """Raw outputs of the decoder, in unit coordinates; rows of padding are zero. Types are the logits' argmax.

    Attributes:
      agents: states.
      lanes: points.
      link_logits: [.., i, j] for the relation of lane i (row, source) to lane j, as ``NormalizedScene.links``.
    """

    agents: Float[Array | np.ndarray, "b agents columns"]
    agent_type_logits: Float[Array | np.ndarray, "b agents agent_types"]
    lanes: Float[Array | np.ndarray, "b lanes points dims"]
    lane_type_logits: Float[Array | np.ndarray, "b lanes lane_types"]
    link_logits: Float[Array | np.ndarray, "b lanes lanes link_types"]


def reparameterize(key: jax.Array, posterior: Posterior) -> PerType:
    """A sample mean + exp(logvar / 2) noise, from one key for the batch or one per scene [B]."""
    keys = PerType(agents=random.fold_in(key, 0), lanes=random.fold_in(key, 1))
    noise = jax.tree.map(lambda k, x: random.normal(k, x.shape, x.dtype), keys, posterior.mean)
    return shift_noise(posterior, noise)


def shift_noise(posterior: Posterior, noise: PerType) -> PerType:
    """mean + exp(logvar / 2) noise; padding has mean 0 and logvar 0, so it becomes the noise itself."""
    return jax.tree.map(lambda m, lv, n: m + jax.numpy.exp(0.5 * lv) * n, posterior.mean, posterior.logvar, noise)
