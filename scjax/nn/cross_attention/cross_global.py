"""Cross-global attention: scene tokens read a dense context directly and through a few learned latents.

As in the release (official-spec §4.5; attention-variants §4.10), or as in the paper.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, Literal

import jax.numpy as jnp
from flax import nnx
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from scjax.nn.attention import attend_heads, merge_heads, split_heads
from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import (
    AuxOutputs,
    ContextSpec,
    CrossAttentionOptions,
    Work,
    active_rows,
    at_least,
    mask_rows,
    one_of,
)
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit
from scjax.nn.layers import LayerNorm, Linear
from scjax.scene.pytree import pytree


@dataclasses.dataclass(frozen=True)
class CrossGlobalOptions(CrossAttentionOptions):
    """Options of ``CrossGlobal``.

    Attributes:
      latent_tokens: learned latents of the coarse path.
      style: "code", the release: the latents keep a residual and a norm, and have keys and values of their own;
        "paper": keys and values come from what they read, through the projections of the direct path.
    """

    name: ClassVar[str] = "cross_global"

    latent_tokens: int = 32
    style: Literal["code", "paper"] = "code"

    def __post_init__(self):
        at_least(self, latent_tokens=1)
        one_of(self, style=("code", "paper"))

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> CrossGlobal:
        """The module of this mechanism."""
        return CrossGlobal(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        latents = self.latent_tokens
        encode = 2 * context * width**2 + 3 * latents * width**2 + 2 * latents * context * width
        return Work(encode, 3 * queries * width**2 + 2 * queries * (context + latents) * width)


@pytree
class ContextCache:
    """The keys of the context, and per head the keys and values of the latents that summarize it."""

    context: Keys
    latent_key: Float[Array, "b h latents d"]
    latent_value: Float[Array, "b h latents d"]


class CrossGlobal(Projections):
    """y = W_o Attn(Q, K, V) + tanh(gate) W_lo Attn(Q, K2, V2), with K2, V2 from latents that attended to K, V."""

    def __init__(
        self,
        options: CrossGlobalOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
        def linear():
            return Linear(width, width, init=init, compute=compute)

        super().__init__(width, heads, init=init, compute=compute)
        self.latent_q = linear()
        self.latent_k, self.latent_v = (linear(), linear()) if options.style == "code" else (None, None)
        self.latent_out = linear()
        self.latent_q_norm = LayerNorm(width)
        self.latent_norm, self.latent_k_norm = (
            (LayerNorm(width), LayerNorm(width)) if options.style == "code" else (None, None)
        )
        self.latents = nnx.Param(init.normal((options.latent_tokens, width), 0.02))
        self.gate = nnx.Param(jnp.zeros(1))

    def encode(
        self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"], trace: dict | None = None
    ) -> ContextCache:
        """Keys and values of the context, and of its summary."""
        keys = self.project(context, mask)
        latents = jnp.broadcast_to(self.latents[...][None], (len(context), *self.latents.shape))
        query = self.latent_q_norm(self.latent_q(latents))
        gathered = self.read(query, keys)
        if self.latent_k is not None and self.latent_v is not None:
            assert self.latent_norm is not None and self.latent_k_norm is not None
            summary = self.latent_norm(latents + gathered)
            latent_key, latent_value = self.latent_k_norm(self.latent_k(summary)), self.latent_v(summary)
        else:
            summary = gathered
            latent_key, latent_value = self.k_norm(self.k(summary)), self.v(summary)
        if trace is not None:
            context = jnp.where(mask[..., None], context, 0)
            trace |= {"K": self.k_norm(self.k(context)), "V": self.v(context)}
            trace |= {"LQ": query, "latent_attn": gathered, "T1": summary, "K2": latent_key, "V2": latent_value}
        latent_key, latent_value = (split_heads(x, self.heads) for x in (latent_key, latent_value))
        return ContextCache(context=keys, latent_key=latent_key, latent_value=latent_value)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: ContextCache, trace: dict | None = None
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """The sum of the direct and the coarse path."""
        query = self.query(x, x_mask)
        full = self.read(query, cache.context)
        coarse = merge_heads(attend_heads(split_heads(query, self.heads), cache.latent_key, cache.latent_value, None))
        out_full, out_coarse = self.out(full), self.latent_out(coarse)
        if trace is not None:
            trace |= {"Q": query, "attn_full": full, "attn_coarse": coarse}
            trace |= {"out_full": out_full, "out_coarse": out_coarse}
        gate = jnp.tanh(self.gate[...])
        y = mask_rows(active_rows(x_mask, cache.context.mask), out_full + gate[None, None] * out_coarse)
        return y, AuxOutputs(metrics={"gate": stop_gradient(gate[0])})
