"""Features of lane pairs c_ij, [B, L, L, C] indexed (destination i, source j), in the cheapest form that holds them.

Attention and edge updates need three things of c: the inner products of its layer norm z with given vectors, weighted
sums of z over the sources, and products of c with a matrix. All three have a closed form when c is a table row per
link type (encoder input) or a sum of two node terms (decoder input), so that [B, L, L, C] need not exist there. The
layer norm is never written out either: with mean-free vectors z_ij . u = rstd_ij (c_ij . u), and a weighted sum of z is
the centred, rstd-weighted sum of c. Its scale and offset are the caller's to fold.

Every leaf leads with the scene axis, so that a batch can be cut into chunks of scenes (``over_scenes``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from scjax.nn.precision import Compute, matmul

EPS = 1e-5
# Rows (lane pairs) that are worked on at once. On a CPU, 64 float32 features of 16,384 pairs are 4 MB: the working set
# of an edge update then stays in the last-level caches. Other devices want large products.
_ROWS = {"cpu": 16_384}
_ROWS_ELSEWHERE = 4_194_304


class TypedEdges(NamedTuple):
    """c_ij = table[types_ij]."""

    types: Int[Array, "b l l"]
    table: Float[Array, "b k c"]

    def scores(self, u: Float[Array, "b h l c"]) -> Float[Array, "b h l l"]:
        """z_ij . u_hi."""
        per_type = jnp.einsum("bhic,bkc->bhik", u, _normalise(self.table))
        return jnp.einsum("bhik,bijk->bhij", per_type, self._one_hot())

    def gather(self, p: Float[Array, "b h l l"]) -> Float[Array, "b h l c"]:
        """sum_j p_hij z_ij."""
        return jnp.einsum("bhik,bkc->bhic", jnp.einsum("bhij,bijk->bhik", p, self._one_hot()), _normalise(self.table))

    def project(self, w: Float[Array, "c o"], compute: Compute) -> Float[Array, "b l l o"]:
        """c_ij W."""
        return self._spread(matmul(self.table, w, compute))

    def dense(self) -> Float[Array, "b l l c"]:
        """c itself."""
        return self._spread(self.table)

    def _one_hot(self) -> Float[Array, "b l l k"]:
        return jax.nn.one_hot(self.types, self.table.shape[1], dtype=self.table.dtype)

    def _spread(self, table: Float[Array, "b k o"]) -> Float[Array, "b l l o"]:
        # A product, not a lookup: its gradient is a product too instead of a serial scatter.
        return jnp.einsum("bijk,bko->bijo", self._one_hot(), table)


class PairEdges(NamedTuple):
    """c_ij = destination_i + source_j."""

    destination: Float[Array, "b l c"]
    source: Float[Array, "b l c"]

    def scores(self, u: Float[Array, "b h l c"]) -> Float[Array, "b h l l"]:
        """z_ij . u_hi."""
        d, s = centred(self.destination), centred(self.source)
        own = jnp.einsum("bhic,bic->bhi", u, d)[..., None]
        return (own + jnp.einsum("bhic,bjc->bhij", u, s)) * pair_rstd(d, s)[:, None]

    def gather(self, p: Float[Array, "b h l l"]) -> Float[Array, "b h l c"]:
        """sum_j p_hij z_ij."""
        d, s = centred(self.destination), centred(self.source)
        p = p * pair_rstd(d, s)[:, None]
        return p.sum(-1, keepdims=True) * d[:, None] + jnp.einsum("bhij,bjc->bhic", p, s)

    def project(self, w: Float[Array, "c o"], compute: Compute) -> Float[Array, "b l l o"]:
        """c_ij W."""
        return matmul(self.destination, w, compute)[:, :, None] + matmul(self.source, w, compute)[:, None]

    def dense(self) -> Float[Array, "b l l c"]:
        """c itself."""
        return self.destination[:, :, None] + self.source[:, None]


class DenseEdges(NamedTuple):
    """c as it is."""

    values: Float[Array, "b l l c"]

    def scores(self, u: Float[Array, "b h l c"]) -> Float[Array, "b h l l"]:
        """z_ij . u_hi."""
        return jnp.einsum("bhic,bijc->bhij", centred(u), self.values) * self._rstd()[:, None]

    def gather(self, p: Float[Array, "b h l l"]) -> Float[Array, "b h l c"]:
        """sum_j p_hij z_ij."""
        return centred(jnp.einsum("bhij,bijc->bhic", p * self._rstd()[:, None], self.values))

    def project(self, w: Float[Array, "c o"], compute: Compute) -> Float[Array, "b l l o"]:
        """c_ij W."""
        return matmul(self.values, w, compute)

    def dense(self) -> Float[Array, "b l l c"]:
        """c itself."""
        return self.values

    def _rstd(self) -> Float[Array, "b l l"]:
        # Two passes: the mean of a ReLU's output is as large as its deviation.
        return jax.lax.rsqrt(jnp.square(centred(self.values)).mean(-1) + EPS)


Edges = TypedEdges | PairEdges | DenseEdges


def centred(x: Float[Array, "*b c"]) -> Float[Array, "*b c"]:
    """Mean-free over the last axis."""
    return x - x.mean(-1, keepdims=True)


def pair_rstd(destination: Float[Array, "b l c"], source: Float[Array, "b l c"]) -> Float[Array, "b l l"]:
    """1 / standard deviation of destination_i + source_j over the features; both must be mean-free."""
    squares = jnp.square(destination).mean(-1)[:, :, None] + jnp.square(source).mean(-1)[:, None]
    cross = jnp.einsum("bic,bjc->bij", destination, source) * (2 / destination.shape[-1])
    return jax.lax.rsqrt(jnp.maximum(squares + cross, 0.0) + EPS)


def over_scenes(function: Callable[..., Any], args: Any, pairs: int) -> Any:
    """``function(args)``, worked out a few scenes at a time and worked out again for the gradient.

    Args:
      function: maps a PyTree with a leading scene axis to another; scenes must be independent of each other.
      args: PyTree of arrays [B, ...].
      pairs: lane pairs of a scene, which decide how many scenes go at once.
    """
    batch = jax.tree.leaves(args)[0].shape[0]
    most = max(1, _ROWS.get(jax.default_backend(), _ROWS_ELSEWHERE) // pairs)
    chunk = max(size for size in range(1, batch + 1) if batch % size == 0 and size <= most)
    function = jax.checkpoint(function)
    if chunk == batch:
        return function(args)
    chunks = jax.tree.map(lambda x: x.reshape(batch // chunk, chunk, *x.shape[1:]), args)
    return jax.tree.map(lambda x: x.reshape(batch, *x.shape[2:]), jax.lax.map(function, chunks))


def _normalise(x: Float[Array, "*b c"]) -> Float[Array, "*b c"]:
    x = centred(x)
    return x * jax.lax.rsqrt(jnp.square(x).mean(-1, keepdims=True) + EPS)
