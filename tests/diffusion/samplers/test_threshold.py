"""Static and dynamic bounds on the estimate of x_0."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.samplers import Threshold
from scjax.diffusion.samplers.threshold import thresholded
from scjax.scene.per_type import PerType


def both(x):
    x = jnp.asarray(x, jnp.float32)
    return PerType(agents=x, lanes=x)


def bounded(x, mask, threshold):
    found = thresholded(both(x), PerType(agents=jnp.asarray(mask), lanes=jnp.asarray(mask)), threshold)
    jax.tree.map(np.testing.assert_array_equal, found.agents, found.lanes)
    return np.asarray(found.lanes)


def test_static_clips_and_none_leaves():
    x = [[[-9.0, 1.0], [3.0, 2.5]]]
    np.testing.assert_array_equal(bounded(x, [[True, True]], Threshold(2.5)), [[[-2.5, 1.0], [2.5, 2.5]]])
    np.testing.assert_array_equal(bounded(x, [[True, True]], None), x)


def test_dynamic_clips_to_a_quantile_and_shrinks_to_the_bound():
    """Of 1, 2, 4, 8 a share of 3/4 does not exceed 4: clipped to 4, then halved."""
    x = [[[1.0, -2.0], [4.0, -8.0]]]
    found = bounded(x, [[True, True]], Threshold(2.0, quantile=0.75))
    np.testing.assert_allclose(found, [[[0.5, -1.0], [2.0, -2.0]]])
    np.testing.assert_allclose(bounded(x, [[True, True]], Threshold(5.0, quantile=0.75)), np.clip(x, -5, 5))


@pytest.mark.parametrize("garbage", [0.0, 1e9])
def test_each_scene_has_its_own_quantile_of_made_tokens_only(garbage):
    scenes = np.array([[[1.0, -2.0], [4.0, -8.0], [garbage] * 2], [[1.0, 1.0], [garbage] * 2, [garbage] * 2]])
    generated = np.array([[True, True, False], [True, False, False]])
    found = bounded(scenes, generated, Threshold(2.0, quantile=0.75))
    np.testing.assert_allclose(found[0, :2], [[0.5, -1.0], [2.0, -2.0]])
    np.testing.assert_allclose(found[1, 0], [1.0, 1.0])
    assert np.isfinite(bounded(scenes, generated & False, Threshold(2.0, quantile=0.75))).all()


@pytest.mark.parametrize("options", [{"bound": 0.0}, {"quantile": 0.0}, {"quantile": 1.5}])
def test_impossible_thresholds_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        Threshold(**options)
