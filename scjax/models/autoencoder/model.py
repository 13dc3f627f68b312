"""The autoencoder as one network and as pure functions (official-spec §2; paper §3.2)."""

from __future__ import annotations

import functools
from typing import Any

import jax
from flax import nnx

from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.decoder import SceneDecoder
from scjax.models.autoencoder.encoder import SceneEncoder
from scjax.models.autoencoder.outputs import Decoded, Posterior, shift_noise
from scjax.models.codec import NormalizedScene
from scjax.nn import random
from scjax.nn.functional import Functional, functional
from scjax.nn.init import ParamInit
from scjax.scene.per_type import PerType


class Autoencoder(nnx.Module):
    """Encoder and decoder; all methods take batches [B] and never mix scenes."""

    def __init__(self, config: AutoencoderConfig, *, init: ParamInit):
        self.encoder = SceneEncoder(config, init=init)
        self.decoder = SceneDecoder(config, init=init)

    def encode(self, tokens: NormalizedScene) -> Posterior:
        """The posterior of each scene's latents."""
        return self.encoder(tokens)

    def decode(self, latents: PerType, mask: PerType) -> Decoded:
        """Scenes from latents; ``mask`` [B, A] and [B, L] is True at real nodes."""
        return self.decoder(latents, mask)

    def reconstruct(self, tokens: NormalizedScene, noise: PerType | None = None) -> tuple[Posterior, Decoded]:
        """The training pass: encodes, samples mean + exp(logvar / 2) noise (the mean without noise), and decodes."""
        posterior = self.encoder(tokens)
        latents = posterior.mean if noise is None else shift_noise(posterior, noise)
        return posterior, self.decoder(latents, PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask))

    def trace(self, tokens: NormalizedScene, latents: PerType) -> tuple[Posterior, Decoded, dict[str, Any]]:
        """``encode(tokens)``, ``decode(latents)`` and every intermediate array, named as in the parity set."""
        encoder, decoder = {}, {}
        posterior = self.encoder(tokens, encoder)
        decoded = self.decoder(latents, PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask), decoder)
        arrays = {f"enc/{name}": value for name, value in encoder.items()}
        return posterior, decoded, arrays | {f"dec/{name}": value for name, value in decoder.items()}


@functools.lru_cache(maxsize=16)
def autoencoder(config: AutoencoderConfig) -> Functional:
    """``init(key) -> params`` and ``apply(params, *args, method="encode" | "decode" | "reconstruct" | "trace")``."""
    return functional(lambda init: Autoencoder(config, init=init))


@functools.lru_cache(maxsize=16)
def decoder(config: AutoencoderConfig) -> Functional:
    """The decoder alone, for the part "decoder" of an autoencoder's parameters: ``apply(params, latents, mask)``."""
    return functional(lambda init: SceneDecoder(config, init=init))


def noise_like(key: jax.Array, tokens: NormalizedScene, config: AutoencoderConfig) -> PerType:
    """Standard normal noise for ``reconstruct``: [B, A, agent_latent] and [B, L, lane_latent].

    ``key`` is one key for the batch, or one per scene [B].
    """
    agents = (*tokens.agent_mask.shape, config.agent_latent)
    lanes = (*tokens.lane_mask.shape, config.lane_latent)
    return PerType(
        agents=random.normal(random.fold_in(key, 0), agents, tokens.agents.dtype),
        lanes=random.normal(random.fold_in(key, 1), lanes, tokens.lanes.dtype),
    )
