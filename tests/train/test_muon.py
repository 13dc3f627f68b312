"""Muon on vectors of parameters: as optax's own on arrays, and its updates have singular values about alike."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from optax.contrib import MuonDimensionNumbers
from optax.contrib import muon as optax_muon

from scjax.nn.functional import flatten
from scjax.train.flat_params import FlatParams
from scjax.train.muon import muon, stacked, unstacked
from scjax.train.optimizer import clip_by_global_norm, learning_rates
from scjax.train.tree_params import TreeParams
from tests.factories.optimizer_steps import assert_same_steps, made_up_gradients

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


@pytest.mark.parametrize("layout", [FlatParams, TreeParams])
def test_muon_on_groups_is_muon_on_arrays(params, layout):
    dimensions = jax.tree_util.tree_map_with_path(
        lambda path, _: MuonDimensionNumbers(0, 1) if path[-1].key == "kernel" else None, params
    )
    rates = learning_rates(0.1, schedule="constant", **_SCHEDULE)
    plain = optax.chain(
        clip_by_global_norm(0.5),
        optax_muon(rates, weight_decay=0.3, consistent_rms=0.2, muon_weight_dimension_numbers=dimensions),
    )
    groups = layout.of(params)
    ours = muon(groups, learning_rate=0.1, weight_decay=0.3, clip=0.5, **_SCHEDULE)
    assert_same_steps(params, groups, plain, ours, rtol=1e-4, atol=1e-5)


def test_muon_update_has_even_singular_values(params):
    """Singular values of an update lie around 0.2 sqrt(larger side) times the rate, though the gradient's do not."""
    groups = FlatParams.of(params)
    optimizer = muon(groups, learning_rate=0.1, weight_decay=0.0, clip=None, steps=10, warmup=0)
    vectors = groups.pack(params)
    slopes = made_up_gradients(params, 0)
    updates, _ = optimizer.update(groups.pack(slopes), optimizer.init(vectors), vectors)
    for path, update in flatten(groups.unpack(updates)).items():
        if path[-1] == "kernel":
            known = np.linalg.svd(flatten(slopes)[path], compute_uv=False)
            found = np.linalg.svd(update, compute_uv=False) / (0.1 * 0.2 * np.sqrt(max(update.shape)))
            assert known.max() / known.min() > 2 > found.max() / found.min()
            assert 0.5 < found.min() < found.max() < 1.5


def test_kernels_of_one_shape_form_one_stack():
    kernels = [jnp.arange(6.0).reshape(2, 3), jnp.arange(4.0).reshape(4, 1), jnp.arange(10.0, 16.0).reshape(2, 3)]
    stacks = stacked(kernels)
    assert [stack.shape for stack in stacks] == [(2, 2, 3), (1, 4, 1)]
    np.testing.assert_array_equal(stacks[0][1], kernels[2])
    for kernel, other in zip(unstacked(stacks, [kernel.shape for kernel in kernels]), kernels, strict=True):
        np.testing.assert_array_equal(kernel, other)
