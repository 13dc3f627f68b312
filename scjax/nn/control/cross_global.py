"""Cross-global attention: scene tokens read a dense context directly and through a few learned latents.

As the release computes it (official-spec §4.5; attention-variants §4.10). Two phases: what depends on the context alone
is encoded once a scene and reused in every denoising step.
"""

from __future__ import annotations

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.attention import attend
from scjax.nn.initial import Draws
from scjax.nn.layers import LayerNorm, Linear
from scjax.nn.precision import Compute
from scjax.pytree import pytree


@pytree
class ContextCache:
    """Keys and values of the context [B, m, d] and of the latents that summarise it [B, latents, d]."""

    key: Float[Array, "b m d"]
    value: Float[Array, "b m d"]
    mask: Bool[Array, "b m"]
    latent_key: Float[Array, "b latents d"]
    latent_value: Float[Array, "b latents d"]


class CrossGlobal(nnx.Module):
    """y = W_o Attn(Q, K, V) + tanh(gate) W_lo Attn(Q, K2, V2), with K2, V2 from latents that attended to K, V."""

    def __init__(self, width: int, heads: int, *, draws: Draws, latent_tokens: int = 32, compute: Compute = "float32"):
        def linear():
            return Linear(width, width, draws=draws, compute=compute)

        self.q, self.k, self.v, self.out = linear(), linear(), linear(), linear()
        self.latent_q, self.latent_k, self.latent_v, self.latent_out = linear(), linear(), linear(), linear()
        self.q_norm, self.k_norm = LayerNorm(width), LayerNorm(width)
        self.latent_q_norm, self.latent_norm, self.latent_k_norm = LayerNorm(width), LayerNorm(width), LayerNorm(width)
        self.latents = nnx.Param(draws.normal((latent_tokens, width), 0.02))
        self.gate = nnx.Param(jnp.zeros(1))
        self.heads = heads

    def encode(
        self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"], trace: dict | None = None
    ) -> ContextCache:
        """Everything that does not depend on the scene tokens. What stands at masked context tokens is ignored."""
        context = jnp.where(mask[..., None], context, 0)
        key, value = self.k_norm(self.k(context)), self.v(context)
        latents = jnp.broadcast_to(self.latents[...][None], (len(context), *self.latents.shape))
        query = self.latent_q_norm(self.latent_q(latents))
        gathered = attend(query, key, value, mask[:, None], self.heads)
        summary = self.latent_norm(latents + gathered)
        latent_key, latent_value = self.latent_k_norm(self.latent_k(summary)), self.latent_v(summary)
        if trace is not None:
            trace |= {"K": key, "V": value, "LQ": query, "latent_attn": gathered, "T1": summary}
            trace |= {"K2": latent_key, "V2": latent_value}
        return ContextCache(key=key, value=value, mask=mask, latent_key=latent_key, latent_value=latent_value)

    def attend(self, x: Float[Array, "b n d"], cache: ContextCache, trace: dict | None = None) -> Float[Array, "b n d"]:
        """What the scene tokens read; exactly zero in scenes without any valid context token."""
        query = self.q_norm(self.q(x))
        full = attend(query, cache.key, cache.value, cache.mask[:, None], self.heads)
        coarse = attend(query, cache.latent_key, cache.latent_value, None, self.heads)
        out_full, out_coarse = self.out(full), self.latent_out(coarse)
        if trace is not None:
            trace |= {"Q": query, "attn_full": full, "attn_coarse": coarse}
            trace |= {"out_full": out_full, "out_coarse": out_coarse}
        y = out_full + jnp.tanh(self.gate[...])[None, None] * out_coarse
        return jnp.where(cache.mask.any(-1)[:, None, None], y, 0)
