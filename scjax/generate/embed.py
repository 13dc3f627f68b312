"""Embeddings of scenes by a trained autoencoder: latents of lanes and agents, and hidden states of lanes.

Values depend on the autoencoder: never compare embeddings of two of them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from scjax.generate.batching import in_batches
from scjax.generate.model import Model
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.model import autoencoder
from scjax.models.codec import SceneCodec
from scjax.scene import Scene, stack
from scjax.scene.per_type import PerType


class Embedding(NamedTuple):
    """One scene: posterior means of its lanes and agents, and the encoder's last hidden states of its lanes."""

    lanes: Float[np.ndarray, "lanes latent"]
    agents: Float[np.ndarray, "agents latent"]
    lane_states: Float[np.ndarray, "lanes width"]


def embed(model: Model, scenes: Iterable[Scene]) -> list[Embedding]:
    """Embeds single scenes, in their order, without padding.

    Raises:
      ValueError: the model has no autoencoder, or a scene has more elements than the largest bucket.
    """
    program = _program(model.codec, model.autoencoder.config)
    scenes = [model.codec.select(scene.to_numpy()) for scene in scenes]
    embeddings: dict[int, Embedding] = {}
    for bucket, indices, rows in in_batches([(len(scene.agent_mask), len(scene.lane_mask)) for scene in scenes]):
        batch = stack([scenes[i] for i in rows], bucket)
        arrays = jax.device_get(program(model.autoencoder.params, batch))
        for row, index in enumerate(indices):
            lanes, agents = len(scenes[index].lane_mask), len(scenes[index].agent_mask)
            counts = (lanes, agents, lanes)
            embeddings[index] = Embedding(*(x[row, :count] for x, count in zip(arrays, counts, strict=True)))
    return [embeddings[index] for index in range(len(scenes))]


@functools.lru_cache(maxsize=8)
def _program(codec: SceneCodec, config: AutoencoderConfig) -> Callable:
    coder = autoencoder(config)
    state = f"enc/block{config.encoder_blocks - 1}/lane"

    def run(params, scenes: Scene):
        tokens = codec.normalize(scenes)
        # The trace needs latents; XLA drops the decoder, whose output is not used.
        latents = PerType(
            agents=jnp.zeros((*tokens.agent_mask.shape, config.agent_latent)),
            lanes=jnp.zeros((*tokens.lane_mask.shape, config.lane_latent)),
        )
        posterior, _, arrays = coder.apply(params, tokens, latents, method="trace")
        return posterior.mean.lanes, posterior.mean.agents, arrays[state]

    return jax.jit(run)
