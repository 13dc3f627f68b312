"""Features of lane pairs c_ij, [B, L, L, C] indexed (destination i, source j), each in its cheapest form.

Attention and edge updates need three results: inner products of c's layer norm z with vectors u, weighted sums of z
over the sources, and products of [n; c] with a matrix, where n are other features of the pairs. All have a closed form
if c is a table row per link type (encoder input) or a sum of two node terms (decoder input); then [B, L, L, C] is never
computed. Nor is the layer norm: with mean-free vectors z_ij . u = rstd_ij (c_ij . u), and a weighted sum of z is
the centered, rstd-weighted sum of c. The caller folds in its scale and offset.

The first field of each form belongs to the destination rows, the others to the scene, so the work can be cut
into blocks of rows i (``blockwise_map``); u, p and the results of ``scores`` and ``gather`` are [B, i, head, .].
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from scjax.nn.cpu import matmul as cpu_matmul
from scjax.nn.layers import EPS, subtract_mean


class TypedEdges(NamedTuple):
    """c_ij = table[types_ij]."""

    types: Int[Array, "b i j"]
    table: Float[Array, "b k c"]

    def scores(self, u: Float[Array, "b i h c"]) -> Float[Array, "b i h j"]:
        """z_ij . u_hi."""
        per_type = jnp.einsum("bihc,bkc->bihk", u, _normalise(self.table))
        return jnp.einsum("bihk,bijk->bihj", per_type, self._one_hot())

    def gather(self, p: Float[Array, "b i h j"]) -> Float[Array, "b i h c"]:
        """sum_j p_hij z_ij."""
        return jnp.einsum("bihk,bkc->bihc", jnp.einsum("bihj,bijk->bihk", p, self._one_hot()), _normalise(self.table))

    def project_with(self, n: Float[Array, "p n"], w: Float[Array, "nc o"]) -> Float[Array, "p o"]:
        """[n_ij; c_ij] W, pairs flattened."""
        own, other = jnp.split(w, [n.shape[1]])
        return cpu_matmul.product(n, own) + self._spread(self.table @ other).reshape(-1, w.shape[1])

    def dense(self) -> Float[Array, "b i j c"]:
        """All c_ij [B, i, j, c]."""
        return self._spread(self.table)

    def _one_hot(self) -> Float[Array, "b i j k"]:
        return jax.nn.one_hot(self.types, self.table.shape[1], dtype=self.table.dtype)

    def _spread(self, table: Float[Array, "b k o"]) -> Float[Array, "b i j o"]:
        # A product, not a lookup: its gradient is a product too instead of a serial scatter.
        return jnp.einsum("bijk,bko->bijo", self._one_hot(), table)


class PairEdges(NamedTuple):
    """c_ij = destination_i + source_j."""

    destination: Float[Array, "b i c"]
    source: Float[Array, "b j c"]

    def scores(self, u: Float[Array, "b i h c"]) -> Float[Array, "b i h j"]:
        """z_ij . u_hi."""
        d, s = subtract_mean(self.destination), subtract_mean(self.source)
        own = jnp.einsum("bihc,bic->bih", u, d)[..., None]
        return (own + jnp.einsum("bihc,bjc->bihj", u, s)) * pair_rstd(d, s)[:, :, None]

    def gather(self, p: Float[Array, "b i h j"]) -> Float[Array, "b i h c"]:
        """sum_j p_hij z_ij."""
        d, s = subtract_mean(self.destination), subtract_mean(self.source)
        p = p * pair_rstd(d, s)[:, :, None]
        return p.sum(-1, keepdims=True) * d[:, :, None] + jnp.einsum("bihj,bjc->bihc", p, s)

    def project_with(self, n: Float[Array, "p n"], w: Float[Array, "nc o"]) -> Float[Array, "p o"]:
        """[n_ij; c_ij] W, pairs flattened."""
        own, other = jnp.split(w, [n.shape[1]])
        pairs = (self.destination @ other)[:, :, None] + (self.source @ other)[:, None]
        return cpu_matmul.product(n, own) + pairs.reshape(-1, w.shape[1])

    def dense(self) -> Float[Array, "b i j c"]:
        """All c_ij [B, i, j, c]."""
        return self.destination[:, :, None] + self.source[:, None]


class DenseEdges(NamedTuple):
    """All c_ij as one array."""

    values: Float[Array, "b i j c"]

    def scores(self, u: Float[Array, "b i h c"]) -> Float[Array, "b i h j"]:
        """z_ij . u_hi."""
        return jnp.einsum("bihc,bijc->bihj", subtract_mean(u), self.values) * self._rstd()[:, :, None]

    def gather(self, p: Float[Array, "b i h j"]) -> Float[Array, "b i h c"]:
        """sum_j p_hij z_ij."""
        return subtract_mean(jnp.einsum("bihj,bijc->bihc", p * self._rstd()[:, :, None], self.values))

    def project_with(self, n: Float[Array, "p n"], w: Float[Array, "nc o"]) -> Float[Array, "p o"]:
        """[n_ij; c_ij] W, pairs flattened."""
        return cpu_matmul.product(jnp.concatenate([n, self.values.reshape(-1, self.values.shape[-1])], -1), w)

    def dense(self) -> Float[Array, "b i j c"]:
        """All c_ij [B, i, j, c]."""
        return self.values

    def _rstd(self) -> Float[Array, "b i j"]:
        # Two passes: the mean of a ReLU's output is as large as its deviation.
        return jax.lax.rsqrt(jnp.square(subtract_mean(self.values)).mean(-1) + EPS)


Edges = TypedEdges | PairEdges | DenseEdges


def pair_rstd(destination: Float[Array, "b i c"], source: Float[Array, "b j c"]) -> Float[Array, "b i j"]:
    """1 / standard deviation of destination_i + source_j over the features; both must be mean-free."""
    squares = jnp.square(destination).mean(-1)[:, :, None] + jnp.square(source).mean(-1)[:, None]
    cross = jnp.einsum("bic,bjc->bij", destination, source) * (2 / destination.shape[-1])
    return jax.lax.rsqrt(jnp.maximum(squares + cross, 0.0) + EPS)


def _normalise(x: Float[Array, "*b c"]) -> Float[Array, "*b c"]:
    x = subtract_mean(x)
    return x * jax.lax.rsqrt(jnp.square(x).mean(-1, keepdims=True) + EPS)
