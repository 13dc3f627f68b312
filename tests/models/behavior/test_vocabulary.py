"""Motion tokens: what is encoded is decoded exactly, and disks keep their distance."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from scjax.models.behavior.config import CLASSES
from scjax.models.behavior.vocabulary import apply_change, build_vocabulary, decode_tokens, motion_errors, token_errors
from scjax.scene import AgentType
from tests.factories.behaviors import small_vocabulary

SIZES = np.float32([4.5, 2.0])


@pytest.mark.parametrize("kind", range(CLASSES))
def test_motions_of_tokens_are_encoded_exactly(kind):
    vocabulary = small_vocabulary()
    tokens = np.arange(vocabulary.shape[1])
    num = len(tokens)
    base = jnp.broadcast_to(jnp.array([1.6, 0.01, 0.02]), (num, 3))
    kinds = jnp.full(num, kind)
    motions = decode_tokens(vocabulary, base, jnp.asarray(tokens), kinds)
    size = [jnp.full(num, value) for value in SIZES]
    errors = np.asarray(token_errors(vocabulary, base, motions, *size, kinds))
    assert errors.min(1).max() < 1e-5
    nearest = decode_tokens(vocabulary, base, jnp.argmin(jnp.asarray(errors), 1), kinds)
    np.testing.assert_array_equal(np.asarray(nearest), np.asarray(motions))


def test_error_is_the_mean_distance_of_corners():
    first, second = jnp.array([1.0, 0.2, 0.1]), jnp.array([0.7, 0.5, 0.1])
    shift = motion_errors(first, second, *map(jnp.asarray, SIZES))  # a shift moves all corners alike
    assert float(shift) == pytest.approx(np.hypot(0.3, 0.3), rel=1e-4)
    turn = motion_errors(first, first.at[2].add(np.pi), *map(jnp.asarray, SIZES))  # corners swap
    assert float(turn) == pytest.approx(np.hypot(*SIZES), rel=1e-4)


def test_vehicles_do_not_roll_back():
    base = jnp.array([[0.05, 0.0, 0.1]] * 2)
    kinds = jnp.array([AgentType.VEHICLE, AgentType.PEDESTRIAN])
    after = np.asarray(apply_change(base, jnp.array([[-0.3, 0.0, 0.0]] * 2), kinds))
    np.testing.assert_array_equal(after[0], 0.0)
    assert after[1, 0] == pytest.approx(-0.25)


def test_first_token_changes_nothing_and_all_differ():
    vocabulary = small_vocabulary()
    np.testing.assert_array_equal(vocabulary[:, 0], 0.0)
    for tokens in vocabulary:
        assert len(np.unique(tokens, axis=0)) == len(tokens)


def test_same_seed_gives_same_vocabulary():
    np.testing.assert_array_equal(small_vocabulary(3), small_vocabulary(3))
    assert not np.array_equal(small_vocabulary(3), small_vocabulary(4))


def test_disks_cover_the_samples():
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(4000, 3)) * [0.05, 0.01, 0.01]
    few, many = (build_vocabulary(samples, AgentType.VEHICLE, size, rng) for size in (16, 128))

    def error(tokens):
        apart = (samples[:, None] - tokens[None]) * [1, 1, 2.5]
        return np.linalg.norm(apart, axis=-1).min(1).mean()

    assert error(many) < 0.6 * error(few)
