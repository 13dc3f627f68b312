"""Products and layer norms of many rows with some 64 features each (lane pairs), in XLA:CPU's fastest forms.

Measured in benchmarks/README.md. Other backends get the plain forms.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.nn.cpu.backend import on_cpu

_SMALL_KERNEL = 128 * 128  # numbers


def linear(x: Float[Array, "m k"], w: Float[Array, "k n"], b: Float[Array, " n"]) -> Float[Array, "m n"]:
    """``x @ w + b``; see ``product``."""
    return add_bias(product(x, w), b)


def product(x: Float[Array, "m k"], w: Float[Array, "k n"]) -> Float[Array, "m n"]:
    """``x @ w``, in the operands' own precision.

    On XLA:CPU the gradient of a small kernel, a sum over all rows, runs at a third to a half of the forward product's
    rate; in groups of rows it is faster. Larger kernels keep the plain form.
    """
    small = w.size <= _SMALL_KERNEL and on_cpu()
    return _by_groups(x, w) if small else x @ w


@jax.custom_vjp
def add_bias(x: Float[Array, "m c"], offset: Float[Array, " c"]) -> Float[Array, "m c"]:
    """``x + offset``."""
    return x + offset[None]


add_bias.defvjp(lambda x, offset: (add_bias(x, offset), None), lambda _, g: (g, _column_sums(g)))


def rstd(x: Float[Array, "m c"], eps: float) -> Float[Array, "m 1"]:
    """1 / standard deviation of each mean-free row."""
    return jax.lax.rsqrt(_row_sums(jnp.square(x)) / x.shape[1] + eps)


@jax.custom_vjp
def affine(
    x: Float[Array, "m c"], factor: Float[Array, "m 1"], scale: Float[Array, " c"], offset: Float[Array, " c"]
) -> Float[Array, "m c"]:
    """``x * factor * scale + offset``: with ``rstd`` of mean-free rows as the factor, their layer norm."""
    return x * factor * scale[None] + offset[None]


def _affine_forward(x, factor, scale, offset):
    return affine(x, factor, scale, offset), (x, factor, scale)


def _affine_backward(saved, g):
    x, factor, scale = saved
    scaled = g * scale[None]
    return scaled * factor, _row_sums(scaled * x), _column_sums(g * (x * factor)), _column_sums(g)


affine.defvjp(_affine_forward, _affine_backward)


def _row_sums(x: Float[Array, "m c"]) -> Float[Array, "m 1"]:
    return x @ jnp.ones((x.shape[1], 1), x.dtype) if _products_sum() else x.sum(1, keepdims=True)


def _column_sums(x: Float[Array, "m c"]) -> Float[Array, " c"]:
    return (jnp.ones((1, len(x)), x.dtype) @ x)[0] if _products_sum() else x.sum(0)


def _products_sum() -> bool:
    return on_cpu()  # faster there; elsewhere products may round their operands


@jax.custom_vjp
def _by_groups(x: Float[Array, "m k"], w: Float[Array, "k n"]) -> Float[Array, "m n"]:
    return x @ w


def _by_groups_forward(x, w):
    return x @ w, (x, w)


def _by_groups_backward(saved, g):
    x, w = saved
    parts = _groups(len(x))
    grouped = (a.reshape(parts, -1, a.shape[1]) for a in (x, g))
    return g @ w.T, jnp.einsum("kmi,kmo->kio", *grouped).sum(0)


_by_groups.defvjp(_by_groups_forward, _by_groups_backward)


def _groups(rows: int) -> int:
    """The least number of equal groups of 64 to 160 rows; 1 where there is none."""
    return next((n for n in range(math.ceil(rows / 160), rows // 64 + 1) if rows % n == 0), 1)
