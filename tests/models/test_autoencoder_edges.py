"""The cheap forms of pair features and the blockwise work on them equal the plain computation."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.models.autoencoder.blocks import EdgeUpdate, GraphAttention
from scjax.models.autoencoder.edges import DenseEdges, PairEdges, TypedEdges
from scjax.nn.cpu import blockwise as chunks
from scjax.nn.cpu.blockwise import blockwise_map
from scjax.nn.functional import functional

B, L, C, H = 2, 5, 6, 3


def normal(seed: int, *shape: int) -> jax.Array:
    return jax.random.normal(jax.random.key(seed), shape)


def form(name: str) -> TypedEdges | PairEdges:
    if name == "pair":
        return PairEdges(normal(2, B, L, C) + 1, normal(3, B, L, C))
    return TypedEdges(jax.random.randint(jax.random.key(9), (B, L, L), 0, 4), normal(1, B, 4, C) + 1)


@pytest.mark.parametrize("name", ["typed", "pair"])
def test_closed_form_edges_equal_dense_edges(name):
    edges = form(name)
    dense = DenseEdges(edges.dense())
    u, p = normal(4, B, L, H, C), jax.nn.softmax(normal(5, B, L, H, L))
    n, w = normal(8, B * L * L, 3), normal(6, 3 + C, 7)
    for method, known in (("scores", [u]), ("gather", [p]), ("project_with", [n, w])):
        result, expected = (getattr(one, method)(*known) for one in (edges, dense))
        np.testing.assert_allclose(result.reshape(expected.shape), expected, 1e-5, 2e-5, err_msg=method)


def test_dense_edges_match_their_definition():
    values = normal(7, B, L, L, C) + 2
    z = (values - values.mean(-1, keepdims=True)) / jnp.sqrt(values.var(-1, keepdims=True) + 1e-5)
    u, p = normal(4, B, L, H, C), normal(5, B, L, H, L)
    np.testing.assert_allclose(DenseEdges(values).scores(u), jnp.einsum("bijc,bihc->bihj", z, u), 1e-4, 1e-4)
    np.testing.assert_allclose(DenseEdges(values).gather(p), jnp.einsum("bijc,bihj->bihc", z, p), 1e-4, 1e-4)
    n, w = normal(8, B * L * L, 3), normal(6, 3 + C, 7)
    expected = n @ w[:3] + values.reshape(-1, C) @ w[3:]
    np.testing.assert_allclose(DenseEdges(values).project_with(n, w), expected, 1e-4, 1e-4)


@pytest.mark.parametrize("pairs", [1, 12, 1000], ids=["row_by_row", "uneven_blocks", "whole_scenes"])
def test_blockwise_map_equals_the_function(monkeypatch, pairs):
    monkeypatch.setattr(chunks, "_SMALL", 0)
    monkeypatch.setattr(chunks, "_BLOCK_PAIRS", pairs)
    shared, rows, weight = (
        {"x": normal(1, B, L, C)},
        (normal(2, B, L, C), jnp.arange(B * L).reshape(B, L)),
        normal(3, C),
    )
    real = jnp.arange(L)[None] < jnp.array([[5], [2]])

    def work(weight):
        def function(shared, rows):
            values, number = rows
            pairs = jnp.tanh(values[:, :, None] * shared["x"][:, None] * weight[None, None, None])
            return pairs.sum(2) * number[..., None], pairs.max(2)

        return function

    def total(weight, shared, rows, blockwise: bool):
        function = work(weight)
        out = blockwise_map(function, shared, rows, real, L) if blockwise else function(shared, rows)
        out = jax.tree.map(lambda x: jnp.where(real[..., None], x, 0), out)
        return (out[0] * jnp.cos(out[0])).sum() + out[1].sum(), out

    def run(blockwise: bool):
        def function(weight, shared, values):
            return total(weight, shared, (values, rows[1]), blockwise)

        return jax.jit(jax.value_and_grad(function, (0, 1, 2), has_aux=True))(weight, shared, rows[0])

    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, 1e-4, 1e-4), run(True), run(False))


def test_layers_do_not_depend_on_block_size(monkeypatch):
    attention = functional(lambda init: GraphAttention(8, 2, 8, init=init, edge_width=C, compute="float32"))
    update = functional(lambda init: EdgeUpdate(8, C, init=init, compute="float32"))
    params = attention.init(jax.random.key(0)), update.init(jax.random.key(1))
    x, values, mask = normal(1, B, L, 8), normal(2, B, L, L, C), jax.random.bernoulli(jax.random.key(3), 0.6, (B, L, L))

    def run():
        def total(params, x, values):
            attended = attention.apply(params[0], x, mask, edges=DenseEdges(values))
            updated = update.apply(params[1], x, DenseEdges(values), jnp.ones((B, L), bool))
            return (jnp.sin(attended).sum() + jnp.sin(updated).sum()), (attended, updated)

        return jax.jit(jax.value_and_grad(total, (0, 1, 2), has_aux=True))(params, x, values)

    whole = run()
    monkeypatch.setattr(chunks, "_SMALL", 0)
    monkeypatch.setattr(chunks, "_BLOCK_PAIRS", 2 * L)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, 1e-4, 1e-5), run(), whole)
