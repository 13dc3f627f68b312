"""Full cross-attention, the reference of all others, and two controls beside it (attention-variants §1.4, §4.2, §4.10).

The controls ask what cross-global attention owes to its latents alone (learned tokens that ignore the condition) and
to its parameters, which are twice as many (wider projections).
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.cpu.online_softmax import attend_chunked
from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import AuxOutputs, ContextSpec, at_least, only, readers
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit


@dataclasses.dataclass(frozen=True)
class FullOptions:
    """Options of ``Full``.

    Attributes:
      memory_tokens: learned tokens that every scene with a condition reads beside it.
      inner_ratio: width between the projections over the width; 2 has the parameters of cross-global attention.
      chunk: keys at a time (see ``scjax.nn.cpu.online_softmax``), for long contexts; 0: all at once.
    """

    memory_tokens: int = 0
    inner_ratio: int = 1
    chunk: int = 0
    empty_is_zero: ClassVar[bool] = True

    def __post_init__(self):
        at_least(self, memory_tokens=0, inner_ratio=1, chunk=0)


class Full(Projections):
    """y = W_o Attn(Q, K, V)."""

    def __init__(
        self, options: FullOptions, width: int, heads: int, spec: ContextSpec, *, init: ParamInit,
        compute: Compute = "float32",
    ):  # fmt: skip
        super().__init__(width, heads, init=init, compute=compute, inner=options.inner_ratio * width)
        shape = (options.memory_tokens, width)
        self.memory = nnx.Param(init.normal(shape, 0.02)) if options.memory_tokens else None
        self.options = options

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Keys:
        """Keys and values of the context and of the memory, which comes last."""
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
            attended = attend_chunked(self.towards(query), cache.key, cache.value, cache.mask, chunk)
            attended = self.offset(attended)
        else:
            attended = self.read(query, cache)
        told = cache.mask[:, : cache.mask.shape[1] - self.options.memory_tokens]
        return only(readers(x_mask, told), self.out(attended)), AuxOutputs()
