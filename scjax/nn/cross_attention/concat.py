"""Concatenation: one softmax over the scene tokens themselves and the condition tokens (attention-variants §4.1).

The paper gives no source for its "simple concatenation". This reading fits behind a frozen backbone: the condition
tokens join the keys and values, plus a learned vector that marks them as condition.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import AuxOutputs, ContextSpec, CrossAttentionOptions, Work, mask_rows
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit


@dataclasses.dataclass(frozen=True)
class ConcatOptions(CrossAttentionOptions):
    """``Concat`` has no options. Without a condition it is self-attention, not zero."""

    name: ClassVar[str] = "concat"
    empty_is_zero: ClassVar[bool] = False

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> Concat:
        """The module of this mechanism."""
        return Concat(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        return Work(2 * context * width**2, 4 * queries * width**2 + 2 * queries * (queries + context) * width)


class Concat(Projections):
    """y = W_o Attn(Q(X), K(S), V(S)) with S = [X; F + e]."""

    def __init__(
        self,
        options: ConcatOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
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
        return mask_rows(x_mask, self.out(self.read(self.query(x, x_mask), keys))), AuxOutputs()
