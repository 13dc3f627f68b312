"""Gated cross-attention (Alayrac et al. 2022, Flamingo, arXiv:2204.14198; attention-variants §4.3).

Flamingo's gates start at zero. Behind an AdaLN gate that also starts at zero, neither gets a gradient. There ``start``
must differ from zero.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import AuxOutputs, ContextSpec, CrossAttentionOptions, Work, active_rows, mask_rows
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit
from scjax.nn.layers import LayerNorm, Linear


@dataclasses.dataclass(frozen=True)
class GatedOptions(CrossAttentionOptions):
    """Options of ``Gated``.

    Attributes:
      start: initial value of the gates before tanh. Flamingo's 0 needs a cross AdaLN that does not start at zero.
      feed_forward: whether a gated MLP of four times the width follows, as in Flamingo. The stage has its own MLP.
    """

    name: ClassVar[str] = "gated"

    start: float = 1.0
    feed_forward: bool = False

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> Gated:
        """The module of this mechanism."""
        return Gated(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        projections = 10 if self.feed_forward else 2
        return Work(2 * context * width**2, projections * queries * width**2 + 2 * queries * context * width)


class Gated(Projections):
    """y = tanh(gate) W_o Attn(Q, K, V) [+ tanh(ffn_gate) MLP(LN(x + the first term))]."""

    def __init__(
        self,
        options: GatedOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
        super().__init__(width, heads, init=init, compute=compute)
        self.gate = nnx.Param(jnp.full(1, options.start))
        self.feed_forward = (
            FeedForward(width, options.start, init=init, compute=compute) if options.feed_forward else None
        )

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Keys:
        """Keys and values."""
        return self.project(context, mask)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Keys
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read, scaled by the gates."""
        gate, rows = jnp.tanh(self.gate[...]), active_rows(x_mask, cache.mask)
        y = gate[None, None] * self.out(self.read(self.query(x, x_mask), cache))
        metrics = {"gate": jax.lax.stop_gradient(gate[0])}
        if self.feed_forward is not None:
            update, metrics["ffn_gate"] = self.feed_forward(mask_rows(rows, x + y))
            y = y + update
        return mask_rows(rows, y), AuxOutputs(metrics=metrics)


class FeedForward(nnx.Module):
    """tanh(gate) W_2 GELU(W_1 LN(x)), without biases."""

    def __init__(self, width: int, start: float, *, init: ParamInit, compute: Compute):
        self.norm = LayerNorm(width)
        self.up = Linear(width, 4 * width, init=init, compute=compute, bias=False)
        self.down = Linear(4 * width, width, init=init, compute=compute, bias=False)
        self.gate = nnx.Param(jnp.full(1, start))

    def __call__(self, x: Float[Array, "b n d"]) -> tuple[Float[Array, "b n d"], Float[Array, ""]]:
        """The update, and the gate for the metrics."""
        gate = jnp.tanh(self.gate[...])
        update = self.down(jax.nn.gelu(self.up(self.norm(x)), approximate=False))
        return gate[None, None] * update, jax.lax.stop_gradient(gate[0])
