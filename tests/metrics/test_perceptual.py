"""The Fréchet distance in its closed forms, sums of parts, and latent descriptors of scenes with nothing in them."""

import numpy as np
import pytest

from scjax.metrics.distances import frechet as frechet_1d
from scjax.metrics.distances import moments
from scjax.metrics.perceptual import Gaussian, gaussian_frechet, latent_descriptor


def samples(seed, number=400, width=5):
    rng = np.random.default_rng(seed)
    return rng.normal(0, 1, (number, width)) @ rng.normal(0, 1, (width, width)) + rng.normal(0, 1, width)


def test_gaussian_frechet_has_its_closed_forms():
    first = Gaussian.of(samples(0))
    assert gaussian_frechet(first, first) == pytest.approx(0, abs=1e-5)
    assert gaussian_frechet(first, Gaussian.of(samples(0) + np.arange(5.0))) == pytest.approx(np.sqrt(30))
    rng = np.random.default_rng(1)
    axes = Gaussian.of(rng.normal(0, [1.0, 2.0], (200_000, 2))), Gaussian.of(rng.normal(0, [3.0, 2.0], (200_000, 2)))
    assert gaussian_frechet(*axes) == pytest.approx(2, rel=0.01)  # |s1 - s2| along the one axis that differs
    assert gaussian_frechet(first, Gaussian.of(samples(3))) == pytest.approx(
        gaussian_frechet(Gaussian.of(samples(3)), first)
    )


def test_gaussian_frechet_in_one_dimension_is_frechet():
    one, two = samples(0, width=1), samples(1, width=1)
    expected = frechet_1d(moments(one[:, 0]), moments(two[:, 0]))
    assert gaussian_frechet(Gaussian.of(one), Gaussian.of(two)) == pytest.approx(expected)


def test_gaussians_of_parts_add_up():
    rows = samples(2)
    whole, parts = Gaussian.of(rows), Gaussian.of(rows[:100]) + Gaussian.of(rows[100:])
    np.testing.assert_allclose(parts.mean, rows.mean(0))
    np.testing.assert_allclose(parts.covariance, np.cov(rows.T))
    assert gaussian_frechet(whole, parts) == pytest.approx(0, abs=1e-5)
    assert np.isnan(gaussian_frechet(whole, Gaussian.of(rows[:1])))


def test_latent_descriptors_leave_the_ego_out():
    lanes, agents, states = [np.ones((3, 4)), np.zeros((0, 4))], [np.ones((1, 2)), samples(0, 5, 2)], [np.ones((3, 6))]
    descriptor = latent_descriptor(lanes, agents, [*states, np.zeros((0, 6))])
    assert descriptor.lane.shape == (2, 8) and descriptor.agent.shape == (2, 4) and descriptor.glob.shape == (2, 6)
    assert not descriptor.agent[0].any() and not descriptor.lane[1].any() and not descriptor.glob[1].any()
    np.testing.assert_allclose(descriptor.agent[1, :2], agents[1][1:].mean(0))
