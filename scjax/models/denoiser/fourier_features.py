"""Fourier features of the latents, because lane connections depend on decimeters in 64 m.

Networks learn small differences of large numbers slowly (spectral bias). The product of two tokens' sines and cosines
is a function of their difference alone, as narrow as the shortest wavelength (Tancik et al. 2020; in a diffusion
model's input: Kingma et al. 2021, section 5). Not in the release.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from scjax.nn.cpu.precision import Compute
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear

LONGEST = 8.0
"""Longest wavelength, in units of a projection, whose initial deviation is that of one latent number."""
OCTAVES = 6
"""Wavelengths by default: the shortest is 0.25, about 3 m of a lane's end. Nine octaves end at 0.03, about 0.4 m."""


class FourierFeatures(nnx.Module):
    """Latents [.., latent] -> an addition to the embedding [.., width]: exactly zero in a fresh network."""

    def __init__(
        self,
        latent: int,
        width: int,
        projections: int,
        *,
        init: ParamInit,
        octaves: int = OCTAVES,
        compute: Compute = "float32",
    ):
        self.project = Linear(latent, projections, init=init, std=latent**-0.5)  # full precision: phases need it
        self.out = Linear(2 * projections * octaves, width, init=init, compute=compute, std=0.0)
        self.octaves = octaves

    def __call__(self, latents: Float[Array, "*b latent"]) -> Float[Array, "*b width"]:
        projected = self.project(latents)
        phases = jnp.stack([projected * (2 * math.pi / LONGEST * 2**k) for k in range(self.octaves)], -1)
        phases = phases.reshape(*latents.shape[:-1], -1)
        return self.out(jnp.concatenate([jnp.sin(phases), jnp.cos(phases)], -1))
