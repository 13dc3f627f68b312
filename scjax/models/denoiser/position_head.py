"""Positions of a token from its latents, by a small network that is fitted to the autoencoder and then frozen.

The autoencoder's decoder is more exact, since it reads all tokens together, but a hundred times slower.
"""

from __future__ import annotations

import functools

import jax
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from scjax.nn.functional import Functional, functional
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear
from scjax.scene import POINTS_PER_LANE
from scjax.scene.per_type import PerType

UNIT = 16.0
"""Meters per unit of the points."""
ALONG = tuple(int(k) for k in np.linspace(0, POINTS_PER_LANE - 1, 5).round())
"""Indices of the predicted points of a lane. Those of an agent are its center and a point ``AHEAD`` in front of it."""
AHEAD = 10.0
"""Meters from an agent's center to its second point."""
POINTS = PerType(agents=2, lanes=len(ALONG))
"""Points per token."""

_HIDDEN = 96


class PositionHead(nnx.Module):
    """Latents [.., latent] -> points [.., points, 2] from the middle of the window, in units of ``UNIT`` meters."""

    def __init__(self, latent: int, points: int, *, init: ParamInit):
        def linear(features_in, features_out):
            return Linear(features_in, features_out, init=init)  # full precision: decimeters in 64 m

        self.skip = linear(latent, 2 * points)
        self.first, self.second, self.out = (
            linear(latent, _HIDDEN),
            linear(_HIDDEN, _HIDDEN),
            linear(_HIDDEN, 2 * points),
        )

    def __call__(self, latents: Float[Array, "*b latent"]) -> Float[Array, "*b points 2"]:
        hidden = jax.nn.gelu(self.second(jax.nn.gelu(self.first(latents))))
        return (self.skip(latents) + self.out(hidden)).reshape(*latents.shape[:-1], -1, 2)


class PositionHeads(nnx.Module):
    """One head for agents and one for lanes: latents -> points, per type."""

    def __init__(self, agent_latent: int, lane_latent: int, *, init: ParamInit):
        self.agents = PositionHead(agent_latent, POINTS.agents, init=init)
        self.lanes = PositionHead(lane_latent, POINTS.lanes, init=init)

    def __call__(self, latents: PerType) -> PerType:
        return PerType(agents=self.agents(latents.agents), lanes=self.lanes(latents.lanes))


@functools.lru_cache(maxsize=16)
def position_heads(agent_latent: int, lane_latent: int) -> Functional:
    """The heads alone, for the part "position_heads" of a denoiser's parameters.

    ``apply(params, latents)`` gives points [B, tokens, points, 2] per type.
    """
    return functional(lambda init: PositionHeads(agent_latent, lane_latent, init=init))
