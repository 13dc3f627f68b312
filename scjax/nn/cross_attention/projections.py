"""The projections that all softmax mechanisms share: q, k, v, out, and layer norms of full width on q and k.

Their parameters have the same names everywhere, so parameters of ``full`` attention initialize any other mechanism
(attention-variants §0, C7).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.attention import attend_heads, merge_heads, split_heads
from scjax.nn.cpu.precision import Compute, matmul
from scjax.nn.init import ParamInit
from scjax.nn.layers import EPS, LayerNorm, Linear, subtract_mean
from scjax.scene.pytree import pytree


@pytree
class Keys:
    """Keys and values of context tokens, per head.

    Scale and offsets are applied later, where they cost less than on a long context.

    Attributes:
      key: normalized, before the norm's scale and offset.
      value: before the bias of its projection.
      mask: True at readable tokens.
    """

    key: Float[Array, "b h m d"]
    value: Float[Array, "b h m d"]
    mask: Bool[Array, "b m"]


class Projections(nnx.Module):
    """Base of the softmax mechanisms; ``inner`` is the width between the projections (default: ``width``)."""

    def __init__(
        self, width: int, heads: int, *, init: ParamInit, compute: Compute = "float32", inner: int | None = None
    ):
        inner = inner or width
        self.q, self.k, self.v = (Linear(width, inner, init=init, compute=compute) for _ in range(3))
        self.out = Linear(inner, width, init=init, compute=compute)
        self.q_norm, self.k_norm = LayerNorm(inner), LayerNorm(inner)
        self.heads = heads

    def project(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Keys:
        """Keys and values. Values at masked tokens are ignored."""
        context = jnp.where(mask[..., None], context, 0)
        assert self.k.bias is not None
        kernels = jnp.concatenate([subtract_mean(self.k.kernel[...]), self.v.kernel[...]], 1)
        flat = matmul(context.reshape(-1, context.shape[-1]), kernels, self.k.compute)
        key, value = jnp.split(flat.reshape(*context.shape[:-1], -1), 2, -1)
        key = key + subtract_mean(self.k.bias[...])[None, None]
        key = key * jax.lax.rsqrt(jnp.square(key).mean(-1, keepdims=True) + EPS)
        return Keys(key=split_heads(key, self.heads), value=split_heads(value, self.heads), mask=mask)

    def query(self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"]) -> Float[Array, "b n inner"]:
        """Normalized queries. Values at masked tokens are ignored."""
        return self.q_norm(self.q(jnp.where(x_mask[..., None], x, 0)))

    def scaled_query(self, query: Float[Array, "b n inner"]) -> Float[Array, "b h n d"]:
        """Queries per head whose products with ``Keys.key`` are the logits of ``query`` and the real keys.

        Of the key norm's z s + t, the query takes s; t adds the same to all logits of a row.
        """
        return split_heads(query * self.k_norm.scale[...][None, None], self.heads)

    def offset(self, attended: Float[Array, "b h n d"]) -> Float[Array, "b n inner"]:
        """Heads joined, plus the bias of the values, which passes through since weights sum to one.

        Rows that read nothing get it too; the mechanisms zero them after the output projection.
        """
        assert self.v.bias is not None
        return merge_heads(attended) + self.v.bias[...][None, None]

    def read(
        self,
        query: Float[Array, "b n inner"],
        keys: Keys,
        mask: Bool[Array, "b q_or_1 m"] | Bool[Array, "b h q_or_1 m"] | None = None,
    ) -> Float[Array, "b n inner"]:
        """Attn(query, keys, values) where ``mask`` is True (default: every query reads every readable token)."""
        mask = keys.mask[:, None] if mask is None else mask
        return self.offset(attend_heads(self.scaled_query(query), keys.key, keys.value, mask))

    def real_keys(self, keys: Keys) -> Float[Array, "b h m d"]:
        """The keys with the scale and offset of their norm."""
        scale, offset = (
            split_heads(part[...][None, None], self.heads) for part in (self.k_norm.scale, self.k_norm.bias)
        )
        return keys.key * scale + offset
