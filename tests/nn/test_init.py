"""Initial values: named by their path, alike for every network that has the path."""

from __future__ import annotations

import chex
import jax
import numpy as np
import pytest
from flax import nnx

from scjax.nn.functional import functional
from scjax.nn.init import BLOCK, ParamInit, path_numbers
from scjax.nn.layers import Linear


class Stack(nnx.Module):
    """Linear layers, and one more in front if asked."""

    def __init__(self, layers: int, first: bool, *, init: ParamInit):
        self.first = Linear(4, 4, init=init) if first else None
        self.layers = nnx.List([Linear(4, 8, init=init, std=0.02) for _ in range(layers)])
        self.last = Linear(8, 4, init=init)


def stack_params(layers: int, first: bool = False):
    return functional(lambda init: Stack(layers, first, init=init)).init(jax.random.key(0))


def test_init_is_unchanged_by_added_layers():
    small, large = stack_params(2), stack_params(5, first=True)
    chex.assert_trees_all_equal(small["last"], large["last"])
    chex.assert_trees_all_equal(small["layers"], {i: large["layers"][i] for i in range(2)})


def test_init_differs_between_paths():
    layers = stack_params(2)["layers"]
    assert not np.array_equal(layers[0]["kernel"], layers[1]["kernel"])


def test_init_differs_between_keys():
    network = functional(lambda init: Linear(4, 4, init=init))
    first, second = (network.init(jax.random.key(seed))["kernel"] for seed in (0, 1))
    assert not np.array_equal(first, second)


@pytest.mark.parametrize("size", [1, BLOCK, 3 * BLOCK + 5])
def test_path_numbers_are_uniform_and_keep_their_prefix(size):
    numbers = path_numbers(jax.random.key(0), ["a", "b"], [size, 40_000])
    assert [len(array) for array in numbers] == [size, 40_000]
    np.testing.assert_array_equal(numbers[0], path_numbers(jax.random.key(0), ["a"], [4 * BLOCK])[0][:size])
    uniform = np.asarray(numbers[1])
    assert -1 < uniform.min() < -0.999 and 0.999 < uniform.max() < 1
    assert abs(uniform.mean()) < 0.01 and abs(uniform.var() - 1 / 3) < 0.01
