"""Groups of parameters, flat or as arrays: nothing is lost, and optimizers do to them what they do to arrays."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from scjax.train.flat_params import FlatParams
from scjax.train.optimizer import adamw
from scjax.train.param_groups import FROZEN, trained
from scjax.train.tree_params import TreeParams
from tests.factories.optimizer_steps import assert_same_steps


@pytest.fixture(scope="module")
def params():
    def draw(i, *shape):
        return jax.random.normal(jax.random.key(i), shape)

    layer = {"kernel": draw(0, 3, 2), "bias": draw(1, 2)}
    return {
        "layers": {0: layer, 1: {"kernel": draw(2, 2, 4), "bias": draw(3, 4)}},
        "table": draw(4, 5, 1),
        "gate": draw(5),
    }


@pytest.mark.parametrize("frozen", [frozenset(), frozenset({("table",), ("layers", 1, "kernel")})])
def test_flat_params_groups_have_the_right_sizes(params, frozen):
    vectors = FlatParams.of(jax.eval_shape(lambda: params), frozen).pack(params)
    assert {name: len(vector) for name, vector in vectors.items()} == (
        {"kernel": 6, "rest": 7, "frozen": 13} if frozen else {"kernel": 14, "rest": 12}
    )
    assert FROZEN not in trained(vectors)


@pytest.mark.parametrize("layout", [FlatParams, TreeParams])
@pytest.mark.parametrize("frozen", [frozenset(), frozenset({("table",), ("layers", 1, "kernel")})])
def test_unpack_inverts_pack(params, frozen, layout):
    groups = layout.of(jax.eval_shape(lambda: params), frozen)
    packed = groups.pack(params)
    for unpacked in (groups.unpack(packed), groups.unpack(jax.device_get(packed))):
        assert jax.tree.structure(unpacked) == jax.tree.structure(params)
        jax.tree.map(np.testing.assert_array_equal, unpacked, params)


@pytest.mark.parametrize("layout", [FlatParams, TreeParams])
def test_join_kernels_inverts_split_kernels(params, layout):
    groups = layout.of(params)
    kernels = groups.pack(params)["kernel"]
    split = groups.split_kernels(kernels)
    assert [kernel.shape for kernel in split] == groups.kernel_shapes == [(3, 2), (2, 4)]
    jax.tree.map(np.testing.assert_array_equal, groups.join_kernels(split), kernels)


@pytest.mark.parametrize("layout", [FlatParams, TreeParams])
def test_adamw_on_groups_is_adamw_on_arrays(params, layout):
    """Clipped by one norm, weight decay on kernels alone."""
    optimizer = adamw(learning_rate=0.1, steps=10, warmup=1, weight_decay=0.3, clip=0.5)
    assert_same_steps(params, layout.of(params), optimizer, optimizer, rtol=1e-6, atol=1e-7)
