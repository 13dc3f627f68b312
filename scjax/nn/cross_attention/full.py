"""Full cross-attention, the reference for all mechanisms, and two controls (attention-variants §1.4, §4.2, §4.10).

The controls measure what cross-global attention gains from its latents alone (``memory_tokens``: learned tokens that
ignore the condition) and from its doubled number of parameters (``inner_ratio``: wider projections).
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.cpu.online_softmax import attend_chunked
from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import (
    AuxOutputs,
    ContextSpec,
    CrossAttentionOptions,
    Work,
    active_rows,
    at_least,
    mask_rows,
)
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit


@dataclasses.dataclass(frozen=True)
class FullOptions(CrossAttentionOptions):
    """Options of ``Full``.

    Attributes:
      memory_tokens: learned tokens that every scene with a condition reads in addition to it.
      inner_ratio: width between the projections over the width; 2 gives the parameters of cross-global attention.
      chunk: keys per chunk (see ``scjax.nn.cpu.online_softmax``), for long contexts; 0: all at once.
    """

    name: ClassVar[str] = "full"

    memory_tokens: int = 0
    inner_ratio: int = 1
    chunk: int = 0

    def __post_init__(self):
        at_least(self, memory_tokens=0, inner_ratio=1, chunk=0)

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> Full:
        """The module of this mechanism."""
        return Full(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        keys, ratio = context + self.memory_tokens, self.inner_ratio
        return Work(ratio * 2 * keys * width**2, ratio * (2 * queries * width**2 + 2 * queries * keys * width))


class Full(Projections):
    """y = W_o Attn(Q, K, V)."""

    def __init__(
        self,
        options: FullOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
        super().__init__(width, heads, init=init, compute=compute, inner=options.inner_ratio * width)
        shape = (options.memory_tokens, width)
        self.memory = nnx.Param(init.normal(shape, 0.02)) if options.memory_tokens else None
        self.options = options

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Keys:
        """Keys and values of the context, then of the memory tokens."""
        if self.memory is not None:
            memory = jnp.broadcast_to(self.memory[...][None], (len(context), *self.memory.shape))
            context = jnp.concatenate([context, memory], 1)
            mask = jnp.concatenate([mask, jnp.ones(memory.shape[:2], bool)], 1)
        return self.project(context, mask)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Keys
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read."""
        query, chunk = self.query(x, x_mask), self.options.chunk
        if chunk:
            attended = attend_chunked(self.scaled_query(query), cache.key, cache.value, cache.mask, chunk)
            attended = self.offset(attended)
        else:
            attended = self.read(query, cache)
        context_mask = cache.mask[:, : cache.mask.shape[1] - self.options.memory_tokens]
        return mask_rows(active_rows(x_mask, context_mask), self.out(attended)), AuxOutputs()
