"""Draws for batches: a key per row makes rows independent of their batch."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn import random

DRAWS = {
    "normal": random.normal,
    "uniform": random.uniform,
    "randint": lambda key, shape: random.randint(key, shape, 0, 1000),
    "bernoulli": lambda key, shape: random.bernoulli(key, 0.5, shape),
}


@pytest.mark.parametrize("name", DRAWS)
def test_rows_with_own_keys_do_not_depend_on_the_batch(name):
    keys = random.row_keys(jax.random.key(0), jnp.arange(6))
    whole = DRAWS[name](keys, (6, 40))
    np.testing.assert_array_equal(whole[2:4], DRAWS[name](keys[2:4], (2, 40)))
    assert not np.array_equal(whole[0], whole[1])


def test_one_key_draws_as_jax_does():
    key = jax.random.key(3)
    np.testing.assert_array_equal(random.normal(key, (4, 5)), jax.random.normal(key, (4, 5)))
    np.testing.assert_array_equal(random.uniform(key, (4,)), jax.random.uniform(key, (4,)))


def test_fold_in_works_on_one_key_and_on_rows():
    keys = random.row_keys(jax.random.key(0), jnp.arange(3))
    assert jnp.array_equal(random.fold_in(keys, 7)[1], jax.random.fold_in(keys[1], 7))
    assert jnp.array_equal(random.fold_in(keys[1], 7), jax.random.fold_in(keys[1], 7))


def test_keys_that_do_not_fit_the_rows_are_refused():
    with pytest.raises(ValueError, match="give one key, or one per row"):
        random.normal(random.row_keys(jax.random.key(0), jnp.arange(3)), (4, 5))
