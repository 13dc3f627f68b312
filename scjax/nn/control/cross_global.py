"""Cross-global attention: scene tokens read a dense context directly and through a few learned latents.

As the release computes it (official-spec §4.5; attention-variants §4.10). Two phases: what depends on the context alone
is encoded once a scene and reused in every denoising step.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.attention import attend_heads, merge_heads, split_heads
from scjax.nn.initial import Draws
from scjax.nn.layers import EPS, LayerNorm, Linear, centred
from scjax.nn.precision import Compute, matmul
from scjax.pytree import pytree


@pytree
class ContextCache:
    """Keys and values, by head, of the context and of the latents that summarise it.

    Attributes:
      key: normalised, but before the norm's scale and offset; value: before its own offset. These are applied where
        they cost less than on a long context.
      mask: True at readable context tokens.
    """

    key: Float[Array, "b h m d"]
    value: Float[Array, "b h m d"]
    mask: Bool[Array, "b m"]
    latent_key: Float[Array, "b h latents d"]
    latent_value: Float[Array, "b h latents d"]


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
        assert self.k.bias is not None
        kernels = jnp.concatenate([centred(self.k.kernel[...]), self.v.kernel[...]], 1)
        flat = matmul(context.reshape(-1, context.shape[-1]), kernels, self.k.compute)
        key, value = jnp.split(flat.reshape(*context.shape[:-1], -1), 2, -1)
        key = key + centred(self.k.bias[...])[None, None]
        key = key * jax.lax.rsqrt(jnp.square(key).mean(-1, keepdims=True) + EPS)
        keys, values = split_heads(key, self.heads), split_heads(value, self.heads)
        latents = jnp.broadcast_to(self.latents[...][None], (len(context), *self.latents.shape))
        query = self.latent_q_norm(self.latent_q(latents))
        gathered = self._read(query, keys, values, mask)
        summary = self.latent_norm(latents + gathered)
        latent_key, latent_value = self.latent_k_norm(self.latent_k(summary)), self.latent_v(summary)
        if trace is not None:
            trace |= {"K": self.k_norm(self.k(context)), "V": self.v(context)}
            trace |= {"LQ": query, "latent_attn": gathered, "T1": summary, "K2": latent_key, "V2": latent_value}
        latent_key, latent_value = (split_heads(x, self.heads) for x in (latent_key, latent_value))
        return ContextCache(key=keys, value=values, mask=mask, latent_key=latent_key, latent_value=latent_value)

    def attend(self, x: Float[Array, "b n d"], cache: ContextCache, trace: dict | None = None) -> Float[Array, "b n d"]:
        """What the scene tokens read; exactly zero in scenes without any valid context token."""
        query = self.q_norm(self.q(x))
        full = self._read(query, cache.key, cache.value, cache.mask)
        coarse = merge_heads(
            attend_heads(split_heads(query, self.heads), cache.latent_key, cache.latent_value, None)
        )  # fmt: skip
        out_full, out_coarse = self.out(full), self.latent_out(coarse)
        if trace is not None:
            trace |= {"Q": query, "attn_full": full, "attn_coarse": coarse}
            trace |= {"out_full": out_full, "out_coarse": out_coarse}
        y = out_full + jnp.tanh(self.gate[...])[None, None] * out_coarse
        return jnp.where(cache.mask.any(-1)[:, None, None], y, 0)

    def _read(self, query: Array, keys: Array, values: Array, mask: Array) -> Array:
        """Attn(query, scale keys + offset, values + offset), without writing these out for a long context.

        Of the norm's affine z s + t, the query takes s; t adds the same to all logits of a row. Weights sum to one, so
        that the offset passes through (into scenes without context too, whose result ``attend`` zeroes).
        """
        assert self.v.bias is not None
        query = split_heads(query * self.k_norm.scale[...][None, None], self.heads)
        return merge_heads(attend_heads(query, keys, values, mask[:, None])) + self.v.bias[...][None, None]
