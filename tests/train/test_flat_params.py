"""Vectors of parameters: nothing lost, groups by what is done to them, and an optimiser's step as by arrays."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from scjax.nn.functional import flatten
from scjax.train.flat_params import KEPT, FlatParams, trained
from scjax.train.optimizer import adamw


@pytest.fixture(scope="module")
def params():
    def draw(i, *shape):
        return jax.random.normal(jax.random.key(i), shape)

    layer = {"kernel": draw(0, 3, 2), "bias": draw(1, 2)}
    return {"layers": {0: layer, 1: {"kernel": draw(2, 2, 4), "bias": draw(3, 4)}}, "table": draw(4, 5, 1),
            "gate": draw(5)}  # fmt: skip


@pytest.mark.parametrize("kept", [frozenset(), frozenset({("table",), ("layers", 1, "kernel")})])
def test_unpacking_what_was_packed_gives_it_back(params, kept):
    packing = FlatParams.of(jax.eval_shape(lambda: params), kept)
    vectors = packing.pack(params)
    assert {name: len(vector) for name, vector in vectors.items()} == (
        {"kernel": 6, "rest": 7, "kept": 13} if kept else {"kernel": 14, "rest": 12}
    )
    assert KEPT not in trained(vectors)
    for back in (packing.unpack(vectors), packing.unpack(jax.device_get(vectors))):
        assert jax.tree.structure(back) == jax.tree.structure(params)
        jax.tree.map(np.testing.assert_array_equal, back, params)


def test_an_optimiser_does_to_vectors_what_it_does_to_arrays(params):
    """Clipped together, weight decay on kernels alone."""
    optimizer = adamw(learning_rate=0.1, steps=10, warmup=1, weight_decay=0.3, clip=0.5)
    assert_same_steps(params, optimizer, optimizer, rtol=1e-6, atol=1e-7)


def assert_same_steps(params, of_arrays, of_vectors, **tolerances):
    """Four steps of one optimiser on arrays and of another on their vectors end at the same parameters."""
    packing = FlatParams.of(params)
    arrays, vectors = params, packing.pack(params)
    states = of_arrays.init(arrays), of_vectors.init(vectors)
    for step in range(4):
        known = gradients(params, step)
        updates, first = of_arrays.update(known, states[0], arrays)
        packed, second = of_vectors.update(packing.pack(known), states[1], vectors)
        arrays, vectors, states = (
            optax.apply_updates(arrays, updates), optax.apply_updates(vectors, packed), (first, second)
        )  # fmt: skip
    for path, value in flatten(packing.unpack(vectors)).items():
        np.testing.assert_allclose(value, flatten(arrays)[path], **tolerances)
        assert not np.allclose(value, flatten(params)[path])


def gradients(params, step):
    """What stands in for the gradients of a step."""
    return jax.tree.map(lambda x: jnp.sin(3 * x + step), params)
