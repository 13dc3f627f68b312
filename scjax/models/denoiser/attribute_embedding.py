"""Requests for attributes as vectors that are added to the embedding of the label."""

from __future__ import annotations

import jax
from flax import nnx
from jaxtyping import Array, Float

from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear


class AttributeEmbedding(nnx.Module):
    """A two-layer network without biases: a request for nothing adds nothing. A fresh one adds nothing at all."""

    def __init__(self, features: int, width: int, *, init: ParamInit):
        self.hidden = Linear(features, width, init=init, bias=False)
        self.out = Linear(width, width, init=init, bias=False, std=0.0)

    def __call__(self, request: Float[Array, "b features"]) -> Float[Array, "b width"]:
        return self.out(jax.nn.silu(self.hidden(request)))
