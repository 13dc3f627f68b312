"""Muon on vectors of parameters: as optax's own on arrays, and its updates have singular values about alike."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from optax.contrib import MuonDimensionNumbers
from optax.contrib import muon as optax_muon

from scjax.diffusion.muon import muon, stacked, unstacked
from scjax.diffusion.optimiser import clip_by_global_norm, learning_rates
from scjax.diffusion.packing import Packing
from scjax.nn.functional import flatten

_SCHEDULE = {"steps": 10, "warmup": 1}


@pytest.fixture(scope="module")
def params():
    def layer(i, inputs, outputs):
        return {
            "kernel": jax.random.normal(jax.random.key(i), (inputs, outputs)),
            "bias": jax.random.normal(jax.random.key(-i), (outputs,)),
        }

    table = jax.random.normal(jax.random.key(9), (5, 3))
    return {"layers": {0: layer(1, 8, 8), 1: layer(2, 8, 16), 2: layer(3, 8, 8)}, "table": table}


def _gradients(params, step):
    return jax.tree.map(lambda x: jnp.sin(3 * x + step), params)


def test_an_update_of_vectors_is_that_of_arrays(params):
    dimensions = jax.tree_util.tree_map_with_path(
        lambda path, _: MuonDimensionNumbers(0, 1) if path[-1].key == "kernel" else None, params
    )
    rates = learning_rates(0.1, schedule="constant", **_SCHEDULE)
    plain = optax.chain(
        clip_by_global_norm(0.5),
        optax_muon(rates, weight_decay=0.3, consistent_rms=0.2, muon_weight_dimension_numbers=dimensions),
    )
    packing = Packing.of(params)
    ours = muon(packing, learning_rate=0.1, weight_decay=0.3, clip=0.5, **_SCHEDULE)
    arrays, vectors = params, packing.pack(params)
    states = plain.init(arrays), ours.init(vectors)
    for step in range(4):
        gradients = _gradients(params, step)
        updates, first = plain.update(gradients, states[0], arrays)
        packed, second = ours.update(packing.pack(gradients), states[1], vectors)
        arrays, vectors, states = (
            optax.apply_updates(arrays, updates), optax.apply_updates(vectors, packed), (first, second)
        )  # fmt: skip
    for path, value in flatten(packing.unpack(vectors)).items():
        np.testing.assert_allclose(value, flatten(arrays)[path], rtol=1e-4, atol=1e-5)
        assert not np.allclose(value, flatten(params)[path])


def test_a_kernel_moves_by_much_the_same_in_every_direction(params):
    """Singular values of an update lie around 0.2 sqrt(larger side) times the rate, though the gradient's do not."""
    packing = Packing.of(params)
    optimiser = muon(packing, learning_rate=0.1, weight_decay=0.0, clip=None, steps=10, warmup=0)
    vectors = packing.pack(params)
    updates, _ = optimiser.update(packing.pack(_gradients(params, 0)), optimiser.init(vectors), vectors)
    for path, update in flatten(packing.unpack(updates)).items():
        if path[-1] == "kernel":
            given = np.linalg.svd(flatten(_gradients(params, 0))[path], compute_uv=False)
            found = np.linalg.svd(update, compute_uv=False) / (0.1 * 0.2 * np.sqrt(max(update.shape)))
            assert given.max() / given.min() > 2 > found.max() / found.min()
            assert 0.5 < found.min() < found.max() < 1.5


def test_kernels_of_one_shape_lie_in_one_stack():
    shapes = [(2, 3), (4, 1), (2, 3)]
    vector = jnp.arange(16.0)
    stacks = stacked(vector, shapes)
    assert [stack.shape for stack in stacks] == [(2, 2, 3), (1, 4, 1)]
    np.testing.assert_array_equal(stacks[0][1], vector[10:].reshape(2, 3))
    np.testing.assert_array_equal(unstacked(stacks, shapes), vector)
