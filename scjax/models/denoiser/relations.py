"""How two tokens lie to each other, read from their noisy latents: what attention needs to see joints and overlaps.

Whether two lanes meet, or a car stands on its lane, is a matter of decimetres between two tokens. Attention over
embeddings has to find it in products of hidden numbers; here it is told. Small networks, fitted to the autoencoder
beforehand and left alone, read a few points of every token (``Anchors``); what one token's points are in the frame of
another makes features of the pair (``Relations``), which bias the attention and are gathered by it, as edge features
are in the autoencoder (official-spec §2.1). Not in the release.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from scjax.nn.initial import Draws
from scjax.nn.layers import Linear
from scjax.nn.precision import Compute

UNIT = 16.0
"""Metres of an anchor's 1."""
POINTS = {"lanes": 3, "agents": 2}
"""Anchors of a token: start, middle, end of a lane; centre of an agent and a point ``AHEAD`` metres before it."""
AHEAD = 10.0

_HIDDEN = 96
_SCALES = (1.0, 4.0, 16.0)  # metres over which differences are told apart
_SHORT = 1.0  # metres below which the direction of a token's points fades


class Anchors(nnx.Module):
    """Latents [.., latent] -> points [.., points, 2] in units of ``UNIT``."""

    def __init__(self, latent: int, points: int, *, draws: Draws):
        def linear(features_in, features_out):
            return Linear(features_in, features_out, draws=draws)  # in full precision: decimetres in 64 m

        self.skip = linear(latent, 2 * points)
        self.first, self.second, self.out = (
            linear(latent, _HIDDEN), linear(_HIDDEN, _HIDDEN), linear(_HIDDEN, 2 * points)
        )  # fmt: skip

    def __call__(self, latents: Float[Array, "*b latent"]) -> Float[Array, "*b points 2"]:
        hidden = jax.nn.gelu(self.second(jax.nn.gelu(self.first(latents))))
        return (self.skip(latents) + self.out(hidden)).reshape(*latents.shape[:-1], -1, 2)


class Relations(nnx.Module):
    """Points of queries and of sources -> features of every pair, modulated by time, label and counts."""

    def __init__(
        self, query_points: int, source_points: int, width: int, features: int, *, draws: Draws, compute: Compute
    ):
        told = 2 * query_points * source_points * len(_SCALES)
        self.first = Linear(told, features, draws=draws, compute=compute)
        self.second = Linear(features, features, draws=draws, compute=compute)
        self.adaln = Linear(width, 2 * features, draws=draws, compute=compute, std=0.0)

    def modulation(self, to: Float[Array, "b d"]) -> Float[Array, "b 2 f"]:
        """Shift and scale from the conditioning vector (after SiLU)."""
        return self.adaln(to).reshape(len(to), 2, -1)

    def __call__(
        self, query: Float[Array, "b n p 2"], source: Float[Array, "b m r 2"], modulation: Float[Array, "b 2 f"]
    ) -> Float[Array, "b n m f"]:
        shift, scale = modulation[:, None, None, 0], modulation[:, None, None, 1]
        hidden = self.first(differences(query, source)) * (1 + scale) + shift
        return jax.nn.gelu(self.second(jax.nn.gelu(hidden)))


def differences(query: Float[Array, "b n p 2"], source: Float[Array, "b m r 2"]) -> Float[Array, "b n m c"]:
    """From each point of the query to each of the source, along and left of the query, squashed at several scales."""
    ahead = query[:, :, -1] - query[:, :, 0]
    ahead = ahead * jax.lax.rsqrt(jnp.square(ahead).sum(-1, keepdims=True) + (_SHORT / UNIT) ** 2)
    cos, sin = (ahead[:, :, None, None, None, i] for i in (0, 1))
    dx, dy = (source[:, None, :, None, :, i] - query[:, :, None, :, None, i] for i in (0, 1))
    along, left = cos * dx + sin * dy, cos * dy - sin * dx
    told = [jnp.tanh(part * (UNIT / scale)) for scale in _SCALES for part in (along, left)]
    pairs = (len(query), query.shape[1], source.shape[1], -1)
    return jnp.concatenate([part.reshape(pairs) for part in told], -1)
