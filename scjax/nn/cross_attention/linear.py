"""Focused linear attention (Han et al. 2023, FLatten Transformer, arXiv:2308.00442; attention-variants §4.4).

The context enters through one d x d matrix and one vector per head. Their size does not depend on its length.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.attention import merge_heads, split_heads
from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import (
    AuxOutputs,
    ContextSpec,
    CrossAttentionOptions,
    Work,
    at_least,
    mask_rows,
    one_of,
)
from scjax.nn.init import ParamInit
from scjax.nn.layers import LayerNorm, Linear
from scjax.scene.pytree import pytree

_TINY = 1e-6  # of the release: added to features and to denominators


@dataclasses.dataclass(frozen=True)
class LinearOptions(CrossAttentionOptions):
    """Options of ``FocusedLinear``.

    Attributes:
      power: exponent that sharpens the features.
      dwc: "value" adds to each value a depthwise convolution over its neighbors in the context: 5 x 5 on the grids of
        an image, 5 along a text.
      qk_norm: layer norms on queries and keys, which the release does not have.
    """

    name: ClassVar[str] = "linear"

    power: int = 3
    dwc: Literal["none", "value"] = "none"
    qk_norm: bool = False

    def __post_init__(self):
        at_least(self, power=1)
        one_of(self, dwc=("none", "value"))

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> FocusedLinear:
        """The module of this mechanism."""
        return FocusedLinear(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        outer = width * (width // heads)
        return Work(2 * context * width**2 + context * outer, 2 * queries * width**2 + queries * outer)


@pytree
class Summary:
    """Means of phi(k) v' and of phi(k) over the readable keys, and whether there is a readable key."""

    outer: Float[Array, "b h d d"]
    key: Float[Array, "b h d"]
    readable: Bool[Array, " b"]


class FocusedLinear(nnx.Module):
    """y = W_o phi(Q) mean(phi(K) V') / (phi(Q) mean(phi(K)))."""

    def __init__(
        self,
        options: LinearOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
        self.q, self.k, self.v, self.out = (Linear(width, width, init=init, compute=compute) for _ in range(4))
        self.q_norm, self.k_norm = (LayerNorm(width), LayerNorm(width)) if options.qk_norm else (None, None)
        self.sigma = nnx.Param(jnp.zeros(width))
        taps = (5, 5) if spec.kind == "image" else (5,)
        kernel = None
        if options.dwc == "value":
            kernel = nnx.Param(init.uniform((*taps, width // heads), 5 ** (-len(taps) / 2)))
        self.dwc = kernel
        self.options, self.heads, self.spec = options, heads, spec

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Summary:
        """The two means."""
        context = jnp.where(mask[..., None], context, 0)
        key = self.k(context) if self.k_norm is None else self.k_norm(self.k(context))
        features = mask_rows(mask, self._features(key)) / jnp.maximum(mask.sum(-1), 1).astype(key.dtype)[:, None, None]
        value = split_heads(self.v(context), self.heads)
        if self.dwc is not None:
            value = value + self._convolve(jnp.where(mask[:, None, :, None], value, 0))
        features = split_heads(features, self.heads)
        return Summary(outer=features.swapaxes(2, 3) @ value, key=features.sum(2), readable=mask.any(-1))

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Summary
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read."""
        query = self.q(mask_rows(x_mask, x))
        query = query if self.q_norm is None else self.q_norm(query)
        features = split_heads(self._features(query), self.heads)
        total = (features * cache.key[:, :, None]).sum(-1, keepdims=True)
        attended = merge_heads(features @ cache.outer / (total + _TINY))
        return mask_rows(x_mask & cache.readable[:, None], self.out(attended)), AuxOutputs()

    def _features(self, x: Float[Array, "b t d"]) -> Float[Array, "b t d"]:
        """phi(x) = |u| u^p / |u^p| with u = (ReLU(x) + 1e-6) / softplus(sigma), over the full width.

        The largest entry is divided out first, which cancels: its power neither overflows nor underflows.
        """
        u = (jax.nn.relu(x) + _TINY) / jax.nn.softplus(self.sigma[...])[None, None]
        powers = (u / jax.lax.stop_gradient(u.max(-1, keepdims=True))) ** self.options.power
        return powers * (jnp.linalg.norm(u, axis=-1, keepdims=True) / jnp.linalg.norm(powers, axis=-1, keepdims=True))

    def _convolve(self, value: Float[Array, "b h m d"]) -> Float[Array, "b h m d"]:
        """The depthwise convolution: one weight per tap and channel, shared by heads; zero padding."""
        assert self.dwc is not None
        kernel, (b, h, m, d) = self.dwc[...], value.shape
        grid = (1, m) if self.spec.grid is None else (self.spec.modalities, *self.spec.grid)
        cells = value.reshape(b * h * grid[0], *grid[1:], d)
        padded = jnp.pad(cells, [(0, 0), *[(2, 2)] * (kernel.ndim - 1), (0, 0)])
        total = jnp.zeros_like(cells)
        for tap in itertools.product(range(5), repeat=kernel.ndim - 1):
            window = tuple(slice(start, start + size) for start, size in zip(tap, grid[1:], strict=True))
            total = total + padded[:, *window] * jnp.broadcast_to(kernel[tap], cells.shape)
        return total.reshape(value.shape)
