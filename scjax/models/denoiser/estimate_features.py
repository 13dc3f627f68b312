"""Self-conditioning: the last x0 estimate as a further input (Chen et al. 2023, "Analog Bits").

In sampling it is the estimate at the noise level before; in training one from the same latents, for half of the scenes.
Tokens that are far from each other can agree on it, and at high noise it has geometry where the latents have none. Not
in the release.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool

from scjax.models.denoiser.fourier_features import FourierFeatures
from scjax.models.denoiser.position_head import PositionHeads
from scjax.models.denoiser.relative_geometry import RelativeGeometry
from scjax.nn.cpu.precision import Compute
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear
from scjax.scene.per_type import PerType
from scjax.scene.pytree import pytree


@pytree
class SelfCondition:
    """An x0 estimate.

    Attributes:
      latents: normalized latents [B, tokens, latent] per type; padding may hold anything.
      present: False at scenes without an estimate [B]; their latents are ignored.
    """

    latents: PerType
    present: Bool[Array, " b"]


class EstimateFeatures(nnx.Module):
    """x0 estimates -> additions to the embeddings: exactly zero in a fresh network, and without an estimate."""

    def __init__(
        self,
        latent: PerType,
        width: PerType,
        *,
        init: ParamInit,
        projections: int = 0,
        octaves: int = 1,
        relative_geometry: bool = False,
        compute: Compute = "float32",
    ):
        def linear(features_in: int, features_out: int) -> Linear:
            return Linear(features_in, features_out, init=init, std=0.0)

        def fourier(features_in: int, features_out: int) -> FourierFeatures | None:
            if not projections:
                return None
            return FourierFeatures(features_in, features_out, projections, init=init, octaves=octaves, compute=compute)

        self.agents, self.lanes = linear(latent.agents, width.agents), linear(latent.lanes, width.lanes)
        self.agent_fourier, self.lane_fourier = fourier(latent.agents, width.agents), fourier(latent.lanes, width.lanes)
        self.relative_geometry = RelativeGeometry(width, init=init, compute=compute) if relative_geometry else None

    def __call__(self, estimate: SelfCondition, masks: PerType, position_heads: PositionHeads | None) -> PerType:
        """Additions [B, tokens, width] per type; ``masks`` are True at valid tokens."""
        seen = jax.tree.map(lambda mask: mask & estimate.present[:, None], masks)
        latents = jax.tree.map(lambda x, mask: jnp.where(mask[..., None], x, 0), estimate.latents, seen)
        features = PerType(agents=self.agents(latents.agents), lanes=self.lanes(latents.lanes))
        if self.agent_fourier is not None and self.lane_fourier is not None:
            fourier = PerType(agents=self.agent_fourier(latents.agents), lanes=self.lane_fourier(latents.lanes))
            features = jax.tree.map(jnp.add, features, fourier)
        if self.relative_geometry is not None and position_heads is not None:
            geometry = self.relative_geometry(position_heads(latents), masks)
            features = jax.tree.map(jnp.add, features, geometry)
        return jax.tree.map(lambda x: jnp.where(estimate.present[:, None, None], x, 0), features)
