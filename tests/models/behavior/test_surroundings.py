"""What the behavior network reads: it depends on no frame, no order and no padding."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.models.behavior.network import behavior_network
from scjax.models.behavior.surroundings import Surroundings, feature_sizes, surroundings_of
from scjax.models.behavior.traffic import WAY, Traffic
from tests.factories.behaviors import SIZES, random_traffic, small_weights

SEEDS = range(4)


_see = jax.jit(functools.partial(surroundings_of, rows=None, neighbors=SIZES.neighbors))
_apply = jax.jit(behavior_network(SIZES).apply)


_see_rows = jax.jit(surroundings_of, static_argnums=2)


def _logits(seen: Surroundings, kind: np.ndarray) -> np.ndarray:
    params = jax.tree.map(jnp.asarray, small_weights().params)
    returns = jnp.zeros(len(kind), jnp.int32)
    parts = _apply(params, seen.own, seen.others, seen.mask, returns, jnp.asarray(kind))
    return np.concatenate([np.asarray(part) for part in parts], -1)


def _moved(traffic: Traffic, angle: float, d_x: float, d_y: float) -> Traffic:
    cos, sin = np.float32(np.cos(angle)), np.float32(np.sin(angle))

    def place(x, y):
        return np.float32(cos * x - sin * y + d_x), np.float32(sin * x + cos * y + d_y)

    (x, y), (way_x, way_y) = place(traffic.x, traffic.y), place(traffic.way_x, traffic.way_y)
    return traffic.replace(x=x, y=y, way_x=way_x, way_y=way_y, heading=np.float32(traffic.heading + angle))


@pytest.mark.parametrize("seed", SEEDS)
def test_network_is_invariant_under_rigid_motion(seed):
    traffic = random_traffic(seed)
    seen = _see(traffic)
    other = _see(_moved(traffic, 1.2, 300.0, -70.0))
    np.testing.assert_allclose(_logits(other, traffic.kind), _logits(seen, traffic.kind), atol=2e-3)


@pytest.mark.parametrize("seed", SEEDS)
def test_network_follows_the_order_of_agents(seed):
    traffic = random_traffic(seed)
    order = np.random.default_rng(seed).permutation(len(traffic.x))
    seen = _logits(_see(traffic), traffic.kind)
    mixed = jax.tree.map(lambda values: values[order], traffic)
    other = _logits(_see(mixed), mixed.kind)
    there = traffic.valid[order]
    np.testing.assert_allclose(other[there], seen[order][there], atol=1e-5)


def test_padding_changes_nothing():
    traffic = random_traffic(3)
    pad = jax.tree.map(lambda values: np.zeros((5, *values.shape[1:]), values.dtype), traffic)
    wide = jax.tree.map(lambda *parts: np.concatenate(parts), traffic, pad)
    seen = _see(traffic)
    other = jax.tree.map(lambda values: values[: len(traffic.x)], _see(wide))
    there = traffic.valid
    np.testing.assert_array_equal(np.asarray(other.mask)[there], np.asarray(seen.mask)[there])
    np.testing.assert_allclose(_logits(other, traffic.kind)[there], _logits(seen, traffic.kind)[there], atol=1e-5)


def test_rows_are_those_of_all():
    traffic = random_traffic(1)
    rows = np.array([4, 0, 2])
    every, some = _see(traffic), _see_rows(traffic, rows, SIZES.neighbors)
    for one, other in zip(jax.tree.leaves(every), jax.tree.leaves(some), strict=True):
        np.testing.assert_allclose(np.asarray(other), np.asarray(one)[rows], atol=1e-5)


def test_gone_agents_are_not_seen():
    traffic = random_traffic(2)
    far = traffic.replace(x=np.where(traffic.valid, traffic.x, traffic.x[0]).astype(np.float32))
    seen, other = _see(traffic), _see(far)
    np.testing.assert_array_equal(np.asarray(other.others)[0], np.asarray(seen.others)[0])


def test_leader_is_the_body_on_the_way():
    traffic = random_traffic(0, agents=3)
    zero = np.zeros(3, np.float32)
    way = np.broadcast_to(WAY, (3, len(WAY)))
    traffic = traffic.replace(
        x=np.array([0, 20, 12], np.float32),
        y=np.array([0, 0.3, 8], np.float32),
        heading=zero,
        length=zero + 4,
        width=zero + 2,
        valid=np.ones(3, bool),
        way_x=np.array([[0], [20], [12]], np.float32) + way,
        way_y=np.array([[0], [0], [8]], np.float32) + 0 * way,
        inside=np.ones((3, len(WAY)), bool),
    )
    seen = _see_rows(traffic, None, 2)
    assert float(seen.lead_gap[0]) == pytest.approx(16.0, abs=0.2)  # between the bumpers, not to the car beside
    assert float(seen.lead_speed[0]) == pytest.approx(float(traffic.motions[1, 0, 0]) / 0.2, rel=1e-3)
    assert float(seen.lead_gap[1]) > 500


def test_feature_sizes_are_those_of_observe():
    seen = _see(random_traffic())
    assert feature_sizes(SIZES.history) == (seen.own.shape[-1], seen.others.shape[-1])
