"""Scenes as a trained autoencoder sees them: latents of lanes and agents, and what it knows of a lane before those.

Values mean nothing outside one autoencoder: never compare what two of them say.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from scjax.generate.model import Model
from scjax.generate.sample import GROUP, bucket_of
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.model import autoencoder
from scjax.models.codec import SceneCodec
from scjax.scene import Scene, stack
from scjax.scene.per_type import PerType


class Embedding(NamedTuple):
    """One scene: posterior means of its lanes and agents, and the encoder's last state of its lanes."""

    lanes: Float[np.ndarray, "lanes latent"]
    agents: Float[np.ndarray, "agents latent"]
    lane_states: Float[np.ndarray, "lanes width"]


def embed(model: Model, scenes: Iterable[Scene]) -> list[Embedding]:
    """Of single scenes without padding, in their order.

    Raises:
      ValueError: the model has no autoencoder, or a scene has more elements than the largest bucket.
    """
    program = _program(model.codec, model.autoencoder.config)
    chosen = [model.codec.select(scene.to_numpy()) for scene in scenes]
    groups: dict[tuple[int, int], list[int]] = {}
    for row, scene in enumerate(chosen):
        groups.setdefault(bucket_of(scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]), []).append(row)
    found: dict[int, Embedding] = {}
    for bucket, members in groups.items():
        for start in range(0, len(members), GROUP):
            part = members[start : start + GROUP]
            batch = stack([chosen[row] for row in part + [part[0]] * (GROUP - len(part))], bucket)
            arrays = jax.device_get(program(model.autoencoder.params, batch))
            for place, row in enumerate(part):
                lanes, agents = len(chosen[row].lane_mask), len(chosen[row].agent_mask)
                counts = (lanes, agents, lanes)
                found[row] = Embedding(*(x[place, :count] for x, count in zip(arrays, counts, strict=True)))
    return [found[row] for row in range(len(chosen))]


@functools.lru_cache(maxsize=8)
def _program(codec: SceneCodec, config: AutoencoderConfig) -> Callable:
    coder = autoencoder(config)
    state = f"enc/block{config.encoder_blocks - 1}/lane"

    def run(params, scenes: Scene):
        tokens = codec.normalize(scenes)
        # Nothing is decoded: what does not reach the result is not computed.
        latents = PerType(
            agents=jnp.zeros((*tokens.agent_mask.shape, config.agent_latent)),
            lanes=jnp.zeros((*tokens.lane_mask.shape, config.lane_latent)),
        )
        posterior, _, arrays = coder.apply(params, tokens, latents, method="trace")
        return posterior.mean.lanes, posterior.mean.agents, arrays[state]

    return jax.jit(run)
