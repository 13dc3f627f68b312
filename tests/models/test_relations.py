"""Features of pairs: what they depend on, and that a fresh network does not hear them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.models.denoiser.relations import UNIT, differences
from scjax.models.nodes import Nodes
from scjax.nn.attention import attend, attend_related
from scjax.nn.functional import flatten, unflatten
from tests import golden

SIZES = {
    "lane_width": 16, "lane_heads": 2, "agent_width": 8, "agent_heads": 2, "blocks": 2, "l2l_stages": 2,
    "mlp_ratio": 2, "lane_latent": 5, "agent_latent": 3, "max_lanes": 9, "max_agents": 7,
}  # fmt: skip
HEARD = {"pair_bias", "pair_out"}


def _points(seed):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(2, 4, 3, 2)), rng.normal(size=(2, 5, 2, 2))


def test_a_pair_is_the_same_wherever_it_lies_and_however_it_is_turned():
    with jax.enable_x64(True):
        query, source = _points(0)
        turn = np.array([[np.cos(1.1), np.sin(1.1)], [-np.sin(1.1), np.cos(1.1)]])
        moved = [points @ turn + np.array([3.0, -7.0]) for points in (query, source)]
        mirrored = [points * np.array([1.0, -1.0]) for points in (query, source)]
        told = [differences(*map(jnp.asarray, pair)) for pair in ((query, source), moved, mirrored)]
        np.testing.assert_allclose(told[1], told[0], atol=1e-12)
        assert np.abs(told[2] - told[0]).max() > 0.1


def test_a_difference_is_told_along_and_left_of_the_query():
    """A query that looks along y, a source 2 m before its start and 1 m to the left of it."""
    query = jnp.array([[[[0.0, 0.0], [0.0, 10.0]]]]) / UNIT
    source = jnp.array([[[[-1.0, 2.0]]]]) / UNIT
    told = np.asarray(differences(query, source)).reshape(3, 2, 2)  # scale; along or left; point of the query
    shrunk = 10 / np.hypot(10, 1)  # what is left of a direction of 10 m
    for scale, row in zip((1.0, 4.0, 16.0), told, strict=True):
        np.testing.assert_allclose(row[0], np.tanh(np.array([2.0, -8.0]) * shrunk / scale), atol=1e-6)
        np.testing.assert_allclose(row[1], np.tanh(np.array([1.0, 1.0]) * shrunk / scale), atol=1e-6)


def test_a_lane_without_length_is_finite():
    with jax.enable_x64(True):
        query, source = jnp.zeros((1, 1, 2, 2)), jnp.zeros((1, 1, 2, 2))
        value, slope = jax.value_and_grad(lambda q: differences(q, source).sum())(query)
        assert np.isfinite(value) and np.isfinite(slope).all()


@pytest.mark.parametrize("rows", [1, 6])
def test_attention_with_relations_is_attention_with_a_bias(rows):
    rng = np.random.default_rng(rows)
    with jax.enable_x64(True):
        q, k, v = (jnp.asarray(rng.normal(size=(2, n, 8))) for n in (6, 5, 5))
        mask = jnp.asarray(rng.random((2, rows, 5)) < 0.6).at[0, 0].set(False)
        bias, pairs = jnp.asarray(rng.normal(size=(2, 6, 5, 4))), jnp.asarray(rng.normal(size=(2, 6, 5, 3)))
        mixed, _ = attend_related(q, k, v, mask, 0 * bias, pairs)
        np.testing.assert_allclose(mixed, attend(q, k, v, mask, 4), atol=1e-12)

        mixed, gathered = attend_related(q, k, v, mask, bias, pairs)
        for scene, row, head in np.ndindex(2, 6, 4):
            part = slice(2 * head, 2 * head + 2)
            logits = k[scene, :, part] @ q[scene, row, part] / np.sqrt(2) + bias[scene, row, :, head]
            p = np.where(mask[scene, row % rows], np.exp(logits), 0)
            p = p / max(p.sum(), 1e-300)
            np.testing.assert_allclose(mixed[scene, row, part], p @ v[scene, :, part], atol=1e-12)
            np.testing.assert_allclose(gathered[scene, row, 3 * head : 3 * head + 3], p @ pairs[scene, row], atol=1e-12)


def test_fresh_relations_are_silent_and_random_ones_are_not():
    rng = np.random.default_rng(0)
    masks = Nodes(agents=np.arange(4)[None] < np.array([[4], [2]]), lanes=np.arange(6)[None] < np.array([[3], [6]]))
    widths = Nodes(agents=3, lanes=5)
    z = jax.tree.map(lambda m, w: rng.normal(size=(*m.shape, w)).astype(np.float32), masks, widths)
    with_relations, plain = (denoiser(DenoiserConfig(**SIZES, relations=n)) for n in (3, 0))
    leaves = flatten(with_relations.init(jax.random.key(0)))
    assert not any(np.any(leaf) for path, leaf in leaves.items() if HEARD & set(path))
    noisy = {path: leaf + 0.3 * rng.normal(size=leaf.shape).astype(np.float32) for path, leaf in leaves.items()}
    silent = {path: 0 * leaf if HEARD & set(path) else leaf for path, leaf in noisy.items()}
    unheard = {path: leaf for path, leaf in noisy.items() if not {"anchors", "relations", *HEARD} & set(path)}

    run = {n: golden.jit(net.apply) for n, net in (("related", with_relations), ("plain", plain))}
    t, label = np.array([3, 70]), np.array([0, 5])
    wanted = run["plain"](unflatten(unheard), z, t, label, masks)
    found = run["related"](unflatten(silent), z, t, label, masks)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-5), found, wanted)
    heard = run["related"](unflatten(noisy), z, t, label, masks)
    assert all(np.abs(x - y).max() > 1e-2 for x, y in zip(*map(jax.tree.leaves, (heard, wanted)), strict=True))
