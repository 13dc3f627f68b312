"""Products of rounded operands: how exact they are, forward and backward, and who decides on them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.cpu import precision
from scjax.nn.cpu.precision import cpu_entry, cpu_flags, matmul, operands

# Each operand is rounded to 8 bits of mantissa.
TOLERANCE = 2**-7


def both(function, *arrays):
    return [jax.jit(function, static_argnums=0)(compute, *arrays) for compute in ("float32", "bfloat16")]


def test_rounded_products_are_near_the_exact_ones_forward_and_backward():
    rng = np.random.default_rng(0)
    x, w, g = (jnp.asarray(rng.normal(size=size), jnp.float32) for size in ((3, 17, 64), (64, 32), (3, 17, 32)))

    def gradients(compute, x, w):
        return jax.grad(lambda x, w: jnp.vdot(matmul(x, w, compute), g), (0, 1))(x, w)

    pairs = [both(lambda compute, x, w: matmul(x, w, compute), x, w), *zip(*both(gradients, x, w), strict=True)]
    for exact, rounded in pairs:
        error = float(jnp.abs(rounded - exact).max() / jnp.abs(exact).max())
        assert 0 < error < TOLERANCE  # 0: nothing was rounded


@pytest.mark.parametrize(
    "vendor, flags, expected",
    [
        ("AuthenticAMD", "fma avx512f avx512_bf16", "bfloat16"),
        ("GenuineIntel", "fma avx512f avx512_bf16", "float32"),
        ("GenuineIntel", "avx512_bf16 amx_tile amx_bf16", "bfloat16"),
        ("AuthenticAMD", "fma avx512f", "float32"),
        ("GenuineIntel", "", "float32"),
    ],
)
def test_auto_rounds_where_the_cpu_multiplies_rounded_numbers_faster(vendor, flags, expected, tmp_path, monkeypatch):
    path = tmp_path / "cpuinfo"
    path.write_text(
        f"processor\t: 0\nvendor_id\t: {vendor}\nflags\t\t: {flags}\n\nprocessor\t: 1\nflags\t\t: {flags}\n"
    )
    assert cpu_flags(str(path)) == set(flags.split())
    monkeypatch.setattr(precision, "cpu_entry", lambda name, _="": cpu_entry(name, str(path)))
    assert operands("auto") == expected
    assert operands("float32") == "float32" and operands("bfloat16") == "bfloat16"


def test_no_features_are_known_without_linux(tmp_path):
    assert cpu_flags(str(tmp_path / "none")) == frozenset()
