"""The one matrix product of the networks, in the precision that the machine does best.

XLA:CPU multiplies float32 at the AVX-512 rate; bfloat16 operands accumulated in float32 are faster with AMX and
on AMD's AVX-512 (benchmarks/README.md), but only in the layout where the contracted axis of the left operand is
last. The backward products are transposed, so the transposed operand is really laid out before the product.
"""

from __future__ import annotations

import functools
import typing
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
from jax.experimental.layout import Layout, with_layout_constraint
from jaxtyping import Array, Float

Compute = Literal["float32", "bfloat16", "auto"]
"""Operands of the products; "auto": bfloat16 on a CPU that multiplies it faster, float32 elsewhere."""


def matmul(x: Float[Array, "*b i"], w: Float[Array, "i o"], compute: Compute) -> Float[Array, "*b o"]:
    """``x @ w``. ``bfloat16`` rounds both operands and accumulates in float32, forward and backward."""
    if operands(compute) == "float32":
        return x @ w
    flat: Array = _mixed(x.reshape(-1, x.shape[-1]), w)
    return flat.reshape(*x.shape[:-1], w.shape[-1])


def operands(compute: Compute) -> Literal["float32", "bfloat16"]:
    """What "auto" is on this machine; the others are what they say.

    Decided by the CPU's instructions and not by a clock: a training that goes on must compute as it began.

    Raises:
      ValueError: no such precision.
    """
    if compute not in typing.get_args(Compute):
        raise ValueError(f"compute must be one of {', '.join(typing.get_args(Compute))}, not {compute!r}")
    if compute != "auto":
        return compute
    flags = cpu_flags()
    # A large product with the instruction of AVX-512 for bfloat16: 1.7 times the rate of float32 on AMD, 0.55 on Intel.
    faster = "amx_bf16" in flags or ("avx512_bf16" in flags and "AuthenticAMD" in cpu_entry("vendor_id"))
    return "bfloat16" if faster and jax.default_backend() == "cpu" else "float32"


def cpu_flags(path: str = "/proc/cpuinfo") -> frozenset[str]:
    """Names of the CPU's features as Linux tells them; empty elsewhere."""
    return cpu_entry("flags", path)


@functools.cache
def cpu_entry(name: str, path: str = "/proc/cpuinfo") -> frozenset[str]:
    """The words that Linux has under a name for the first processor; none elsewhere."""
    try:
        lines = Path(path).read_text().splitlines()
    except OSError:
        return frozenset()
    return frozenset(next((line.split(":", 1)[1].split() for line in lines if line.startswith(name)), ()))


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
