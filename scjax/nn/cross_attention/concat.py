"""Concatenation: one softmax over the scene tokens themselves and the condition tokens (attention-variants §4.1).

The paper cites nothing for its "simple concatenation". Of the readings, this one fits a slot behind a frozen
backbone: the condition joins the keys and values, with a learned vector that tells it from the scene.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import AuxOutputs, ContextSpec, only
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit


@dataclasses.dataclass(frozen=True)
class ConcatOptions:
    """``Concat`` has no options. Without a condition it is self-attention, not zero."""

    empty_is_zero: ClassVar[bool] = False


class Concat(Projections):
    """y = W_o Attn(Q(X), K(S), V(S)) with S = [X; F + e]."""

    def __init__(
        self, options: ConcatOptions, width: int, heads: int, spec: ContextSpec, *, init: ParamInit,
        compute: Compute = "float32",
    ):  # fmt: skip
        super().__init__(width, heads, init=init, compute=compute)
        self.kind = nnx.Param(init.normal((width,), 0.02))

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Keys:
        """Keys and values of the condition."""
        return self.project(context + self.kind[...][None, None], mask)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Keys
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """Scene tokens read each other and the condition."""
        own = self.project(x, x_mask)
        keys = Keys(
            key=jnp.concatenate([own.key, cache.key], 2),
            value=jnp.concatenate([own.value, cache.value], 2),
            mask=jnp.concatenate([own.mask, cache.mask], 1),
        )
        return only(x_mask, self.out(self.read(self.query(x, x_mask), keys))), AuxOutputs()
