"""Linear, layer norm and residual MLP, the layers of all networks of scjax (official-spec §2.1, §4.1)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from scjax.nn.cpu.precision import Compute, matmul
from scjax.nn.init import ParamInit

EPS = 1e-5  # of the official model's layer norms


class Linear(nnx.Module):
    """y = x W + b with W [in, out], xavier-uniform, or N(0, std^2) with ``std``; the bias starts at zero."""

    def __init__(
        self,
        features_in: int,
        features_out: int,
        *,
        init: ParamInit,
        bias: bool = True,
        compute: Compute = "float32",
        std: float | None = None,
    ):
        shape = (features_in, features_out)
        self.kernel = nnx.Param(init.xavier(shape) if std is None else init.normal(shape, std))
        self.bias = nnx.Param(jnp.zeros(features_out)) if bias else None
        self.compute: Compute = compute

    def __call__(self, x: Float[Array, "*b i"]) -> Float[Array, "*b o"]:
        # One flat product: on XLA:CPU, weight gradients of products over several axes run at a third of the rate.
        y = matmul(x.reshape(-1, x.shape[-1]), self.kernel[...], self.compute).reshape(*x.shape[:-1], -1)
        return y if self.bias is None else y + _lift(self.bias[...], y.ndim)


def fused_linear(linears: Sequence[Linear], x: Float[Array, "*b i"], zeros: int = 0) -> list[Float[Array, "*b _"]]:
    """The result of each layer for the same x, by one product that reads x only once.

    The last ``zeros`` numbers of each row of x are padding without weights.
    """
    kernel = jnp.concatenate([linear.kernel[...] for linear in linears], 1)
    kernel = jnp.pad(kernel, ((0, zeros), (0, 0)))
    flat = matmul(x.reshape(-1, x.shape[-1]), kernel, linears[0].compute).reshape(*x.shape[:-1], -1)
    ends = list(itertools.accumulate(linear.kernel.shape[1] for linear in linears))
    parts = jnp.split(flat, ends[:-1], -1)
    return [
        part if linear.bias is None else part + _lift(linear.bias[...], part.ndim)
        for part, linear in zip(parts, linears, strict=True)
    ]


class LayerNorm(nnx.Module):
    """Layer norm over the last axis with scale and offset, biased variance."""

    def __init__(self, features: int, eps: float = EPS):
        self.scale = nnx.Param(jnp.ones(features))
        self.bias = nnx.Param(jnp.zeros(features))
        self.eps = eps

    def __call__(self, x: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
        return standardize(x, self.eps) * _lift(self.scale[...], x.ndim) + _lift(self.bias[...], x.ndim)


def standardize(x: Float[Array, "*b d"], eps: float) -> Float[Array, "*b d"]:
    """Zero mean and unit (biased) variance over the last axis: layer norm without parameters."""
    x = subtract_mean(x)
    return x * jax.lax.rsqrt(jnp.square(x).mean(-1, keepdims=True) + eps)


def subtract_mean(x: Float[Array, "*b c"]) -> Float[Array, "*b c"]:
    """x minus its mean over the last axis. Products with a centered kernel and bias need one pass less for a norm."""
    return x - x.mean(-1, keepdims=True)


class ResidualMLP(nnx.Module):
    """depth x (Linear, LN) with ReLU between, plus a Linear-LN skip, ReLU, and an optional last Linear.

    official-spec §2.1 ("ResidualMLP"); the denoiser's embedders are the depth-2 case without ``features_out``.
    """

    def __init__(
        self,
        features_in: int,
        width: int,
        *,
        init: ParamInit,
        depth: int = 2,
        features_out: int | None = None,
        compute: Compute = "float32",
    ):
        sizes = [features_in] + [width] * depth
        self.linears = nnx.List([Linear(i, o, init=init, compute=compute) for i, o in itertools.pairwise(sizes)])
        self.norms = nnx.List([LayerNorm(width) for _ in range(depth)])
        self.skip = Linear(features_in, width, init=init, compute=compute)
        self.skip_norm = LayerNorm(width)
        self.out = None if features_out is None else Linear(width, features_out, init=init, compute=compute)

    def __call__(self, x: Float[Array, "*b i"]) -> Float[Array, "*b o"]:
        return self.after_first(self.linears[0](x), self.skip(x))

    def after_first(self, first: Float[Array, "*b h"], skip: Float[Array, "*b h"]) -> Float[Array, "*b o"]:
        """The network after its two products with the input, which callers may compute more cheaply."""
        hidden = self.norms[0](first)
        for linear, norm in zip(list(self.linears)[1:], list(self.norms)[1:], strict=True):
            hidden = norm(linear(jax.nn.relu(hidden)))
        hidden = jax.nn.relu(hidden + self.skip_norm(skip))
        return hidden if self.out is None else self.out(hidden)


def _lift(vector: Float[Array, " d"], rank: int) -> Float[Array, "*ones d"]:
    """[d] -> [1, ..., 1, d]: ranks are never promoted silently."""
    return vector.reshape((1,) * (rank - 1) + vector.shape)
