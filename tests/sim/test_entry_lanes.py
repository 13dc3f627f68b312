"""Lanes at which vehicles enter a map: drawn evenly, whatever the padding."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.sim.border import entry_lanes
from scjax.sim.preparation import prepare
from tests.factories.road_scenes import straight_road


@pytest.fixture(scope="module")
def network():
    return prepare(straight_road().scene(), 0, np.random.default_rng(0)).network


def test_each_entry_is_as_likely(network):
    flags = np.zeros(len(network.first), bool)
    flags[[0, 5, 6, 255]] = True
    lanes = np.asarray(entry_lanes(jax.random.key(0), network.replace(is_entry=jnp.asarray(flags)), 4000))
    rows, counts = np.unique(lanes, return_counts=True)
    assert rows.tolist() == [0, 5, 6, 255]
    assert counts.min() > 900  # of 1,000 each; the standard deviation is 27


def test_padding_draws_the_same_lanes(network):
    flags = jnp.asarray(np.arange(len(network.first)) % 7 == 3)
    wide = network.replace(is_entry=jnp.concatenate([flags, jnp.zeros(512, bool)]))
    few, many = (
        entry_lanes(jax.random.key(1), one, num) for one, num in ((network.replace(is_entry=flags), 8), (wide, 64))
    )
    np.testing.assert_array_equal(few, many[:8])


def test_no_entry_gives_some_lane(network):
    lanes = np.asarray(entry_lanes(jax.random.key(0), network.replace(is_entry=jnp.zeros(256, bool)), 3))
    assert ((lanes >= 0) & (lanes < 256)).all()
