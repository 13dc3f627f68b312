"""Products and norms of many short rows equal the plain formulas, forward and backward, on every backend's path."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.cpu import matmul as cpu_matmul
from scjax.nn.layers import EPS, subtract_mean


def drawn(*shapes):
    rng = np.random.default_rng(0)
    return [jnp.asarray(rng.normal(size=shape), jnp.float32) for shape in shapes]


def assert_same(result, expected, arrays, g):
    """The same values, and the same gradient for every argument."""

    def both(function):
        value, back = jax.vjp(function, *arrays)
        return value, *back(g)

    for one, other in zip(both(result), both(expected), strict=True):
        np.testing.assert_allclose(one, other, 1e-4, 1e-4)


@pytest.fixture(params=["products", "sums"])
def sums(request, monkeypatch):
    monkeypatch.setattr(cpu_matmul, "_products_sum", lambda: request.param == "products")


@pytest.mark.parametrize("rows, features", [(512, 64), (1012, 64), (509, 64), (24, 64), (512, 128), (1000, 256)])
def test_linear_equals_plain_form(rows, features, sums):
    x, w, b, g = drawn((rows, 64), (64, features), (features,), (rows, features))
    assert_same(cpu_matmul.linear, lambda x, w, b: x @ w + b[None], (x, w, b), g)


def test_affine_with_rstd_is_layer_norm(sums):
    x, scale, offset, g = drawn((96, 64), (64,), (64,), (96, 64))

    def plain(x, scale, offset):
        x = subtract_mean(x)
        return x / jnp.sqrt(x.var(1, keepdims=True) + EPS) * scale[None] + offset[None]

    def result(x, scale, offset):
        x = subtract_mean(x)
        return cpu_matmul.affine(x, cpu_matmul.rstd(x, EPS), scale, offset)

    assert_same(result, plain, (x, scale, offset), g)


def test_affine_gradient_of_factor(sums):
    arrays = drawn((40, 8), (40, 1), (8,), (8,))
    (g,) = drawn((40, 8))
    assert_same(cpu_matmul.affine, lambda x, f, s, o: x * f * s[None] + o[None], arrays, g)


@pytest.mark.parametrize("rows, groups", [(512, 4), (1012, 11), (509, 1), (24, 1), (160, 1), (161, 1), (162, 2)])
def test_groups_divide_rows_evenly(rows, groups):
    assert cpu_matmul._groups(rows) == groups
