"""The one matrix product of the networks, in the precision that the machine does best.

XLA:CPU multiplies float32 at the AVX-512 rate; bfloat16 operands accumulated in float32 reach the AMX tiles, several
times faster, but only in the layout where the contracted axis of the left operand is last. The backward products are
transposed, so the transposed operand is really laid out before the product.
"""

from __future__ import annotations

from typing import Literal

import jax
import jax.numpy as jnp
from jax.experimental.layout import Layout, with_layout_constraint
from jaxtyping import Array, Float

Compute = Literal["float32", "bfloat16"]


def matmul(x: Float[Array, "*b i"], w: Float[Array, "i o"], compute: Compute) -> Float[Array, "*b o"]:
    """``x @ w``. ``bfloat16`` rounds both operands and accumulates in float32, forward and backward."""
    if compute == "float32":
        return x @ w
    flat: Array = _mixed(x.reshape(-1, x.shape[-1]), w)
    return flat.reshape(*x.shape[:-1], w.shape[-1])


def _product(a: Float[Array, "m k"], b: Float[Array, "k n"]) -> Float[Array, "m n"]:
    return jnp.dot(a.astype(jnp.bfloat16), b.astype(jnp.bfloat16), preferred_element_type=jnp.float32)


def _transposed(a: Float[Array, "m n"]) -> Float[Array, "n m"]:
    return with_layout_constraint(a.astype(jnp.bfloat16).T, Layout((0, 1)))


@jax.custom_vjp
def _mixed(x: Float[Array, "m k"], w: Float[Array, "k n"]) -> Float[Array, "m n"]:
    return _product(x, w)


def _forward(x, w):
    return _product(x, w), (x, w)


def _backward(saved, g):
    x, w = saved
    return _product(g, _transposed(w)), _product(_transposed(x), g)


_mixed.defvjp(_forward, _backward)
