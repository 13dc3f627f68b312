"""The Fréchet distance in its closed forms, sums of parts, and latent descriptors of scenes with nothing in them."""

import numpy as np
import pytest

from scjax.metrics.distances import frechet as frechet_1d
from scjax.metrics.distances import moments
from scjax.metrics.perceptual import Gaussian, frechet, latent_descriptor


def drawn(seed, number=400, width=5):
    rng = np.random.default_rng(seed)
    return rng.normal(0, 1, (number, width)) @ rng.normal(0, 1, (width, width)) + rng.normal(0, 1, width)


def test_closed_forms():
    first = Gaussian.of(drawn(0))
    assert frechet(first, first) == pytest.approx(0, abs=1e-5)
    assert frechet(first, Gaussian.of(drawn(0) + np.arange(5.0))) == pytest.approx(np.sqrt(30))
    rng = np.random.default_rng(1)
    axes = Gaussian.of(rng.normal(0, [1.0, 2.0], (200_000, 2))), Gaussian.of(rng.normal(0, [3.0, 2.0], (200_000, 2)))
    assert frechet(*axes) == pytest.approx(2, rel=0.01)  # |s1 - s2| along the one axis that differs
    assert frechet(first, Gaussian.of(drawn(3))) == pytest.approx(frechet(Gaussian.of(drawn(3)), first))


def test_one_dimension_is_the_other_definition():
    one, two = drawn(0, width=1), drawn(1, width=1)
    wanted = frechet_1d(moments(one[:, 0]), moments(two[:, 0]))
    assert frechet(Gaussian.of(one), Gaussian.of(two)) == pytest.approx(wanted)


def test_parts_add_up():
    rows = drawn(2)
    whole, parts = Gaussian.of(rows), Gaussian.of(rows[:100]) + Gaussian.of(rows[100:])
    np.testing.assert_allclose(parts.mean, rows.mean(0))
    np.testing.assert_allclose(parts.covariance, np.cov(rows.T))
    assert frechet(whole, parts) == pytest.approx(0, abs=1e-5)
    assert np.isnan(frechet(whole, Gaussian.of(rows[:1])))


def test_latent_descriptors_leave_the_ego_out():
    lanes, agents, states = [np.ones((3, 4)), np.zeros((0, 4))], [np.ones((1, 2)), drawn(0, 5, 2)], [np.ones((3, 6))]
    found = latent_descriptor(lanes, agents, [*states, np.zeros((0, 6))])
    assert found.lane.shape == (2, 8) and found.agent.shape == (2, 4) and found.glob.shape == (2, 6)
    assert not found.agent[0].any() and not found.lane[1].any() and not found.glob[1].any()
    np.testing.assert_allclose(found.agent[1, :2], agents[1][1:].mean(0))
