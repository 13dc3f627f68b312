"""Matrix products with rounded operands, and how their precision is named."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.cpu.backend import bfloat16_is_faster
from scjax.nn.cpu.precision import check_compute, matmul, operands

# Each operand is rounded to 8 bits of mantissa.
TOLERANCE = 2**-7


def both(function, *arrays):
    return [jax.jit(function, static_argnums=0)(compute, *arrays) for compute in ("float32", "bfloat16")]


def assert_close_and_rounded(exact, rounded):
    error = float(jnp.abs(rounded - exact).max() / jnp.abs(exact).max())
    assert 0 < error < TOLERANCE  # 0: nothing was rounded


@pytest.fixture
def arrays():
    rng = np.random.default_rng(0)
    return [jnp.asarray(rng.normal(size=size), jnp.float32) for size in ((3, 17, 64), (64, 32), (3, 17, 32))]


def test_matmul_bfloat16_is_near_float32(arrays):
    x, w, _ = arrays
    assert_close_and_rounded(*both(lambda compute, x, w: matmul(x, w, compute), x, w))


def test_matmul_bfloat16_gradients_are_near_float32(arrays):
    x, w, g = arrays

    def gradients(compute, x, w):
        return jax.grad(lambda x, w: jnp.vdot(matmul(x, w, compute), g), (0, 1))(x, w)

    for exact, rounded in zip(*both(gradients, x, w), strict=True):
        assert_close_and_rounded(exact, rounded)


def test_operands_resolves_auto_by_the_machine():
    assert operands("auto") == ("bfloat16" if bfloat16_is_faster() else "float32")


@pytest.mark.parametrize("compute", ["float32", "bfloat16"])
def test_operands_keeps_named_precisions(compute):
    assert operands(compute) == compute


def test_check_compute_names_the_known_precisions():
    with pytest.raises(ValueError, match="must be one of float32, bfloat16, auto, not 'float16'"):
        check_compute("float16")
