"""The one matrix product of the networks, in the precision that the machine multiplies fastest.

XLA:CPU multiplies float32 at the AVX-512 rate. Products of bfloat16 operands, accumulated in float32, are faster with
AMX and with AMD's AVX-512 (benchmarks/README.md), but only if the contracted axis of the left operand is the last one.
The products of the backward pass are transposed, so the transposed operand is copied into that layout first.
"""

from __future__ import annotations

import typing
from typing import Literal

import jax
import jax.numpy as jnp
from jax.experimental.layout import Layout, with_layout_constraint
from jaxtyping import Array, Float

from scjax.nn.cpu.backend import bfloat16_is_faster, on_cpu

Compute = Literal["float32", "bfloat16", "auto"]
"""Operands of the products; "auto": bfloat16 on GPU and TPU and on CPUs that multiply it faster, float32 elsewhere."""


def matmul(x: Float[Array, "*b i"], w: Float[Array, "i o"], compute: Compute) -> Float[Array, "*b o"]:
    """``x @ w``. ``bfloat16`` rounds both operands and accumulates in float32, forward and backward."""
    if operands(compute) == "float32":
        return x @ w
    flat: Array = _mixed(x.reshape(-1, x.shape[-1]), w)
    return flat.reshape(*x.shape[:-1], w.shape[-1])


def check_compute(compute: str) -> None:
    """Checks the name of a precision. Does not ask JAX for its backend: configs are read before devices are chosen.

    Raises:
      ValueError: no such precision.
    """
    if compute not in typing.get_args(Compute):
        raise ValueError(f"compute must be one of {', '.join(typing.get_args(Compute))}, not {compute!r}")


def operands(compute: Compute) -> Literal["float32", "bfloat16"]:
    """The precision of the operands on this machine: "auto" is resolved, the others stay as they are.

    Raises:
      ValueError: no such precision.
    """
    check_compute(compute)
    if compute != "auto":
        return compute
    return "bfloat16" if bfloat16_is_faster() else "float32"


def _product(a: Float[Array, "m k"], b: Float[Array, "k n"]) -> Float[Array, "m n"]:
    return jnp.dot(a.astype(jnp.bfloat16), b.astype(jnp.bfloat16), preferred_element_type=jnp.float32)


def _transposed(a: Float[Array, "m n"]) -> Float[Array, "n m"]:
    transposed = a.astype(jnp.bfloat16).T
    return with_layout_constraint(transposed, Layout((0, 1))) if on_cpu() else transposed


@jax.custom_vjp
def _mixed(x: Float[Array, "m k"], w: Float[Array, "k n"]) -> Float[Array, "m n"]:
    return _product(x, w)


def _mixed_forward(x, w):
    return _product(x, w), (x, w)


def _mixed_backward(saved, g):
    x, w = saved
    return _product(g, _transposed(w)), _product(_transposed(x), g)


_mixed.defvjp(_mixed_forward, _mixed_backward)
