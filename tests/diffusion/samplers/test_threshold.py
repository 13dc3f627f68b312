"""Static and dynamic bounds on the x0 estimate."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.samplers import Threshold
from scjax.diffusion.samplers.threshold import threshold_x0
from scjax.scene.per_type import PerType


def both(x):
    x = jnp.asarray(x, jnp.float32)
    return PerType(agents=x, lanes=x)


def bounded(x, mask, threshold):
    x0 = threshold_x0(both(x), PerType(agents=jnp.asarray(mask), lanes=jnp.asarray(mask)), threshold)
    jax.tree.map(np.testing.assert_array_equal, x0.agents, x0.lanes)
    return np.asarray(x0.lanes)


def test_static_threshold_clips_and_none_does_not():
    x = [[[-9.0, 1.0], [3.0, 2.5]]]
    np.testing.assert_array_equal(bounded(x, [[True, True]], Threshold(2.5)), [[[-2.5, 1.0], [2.5, 2.5]]])
    np.testing.assert_array_equal(bounded(x, [[True, True]], None), x)


def test_dynamic_threshold_clips_to_a_quantile_and_rescales():
    """3/4 of 1, 2, 4, 8 do not exceed 4: values are clipped to 4, then halved."""
    x = [[[1.0, -2.0], [4.0, -8.0]]]
    x0 = bounded(x, [[True, True]], Threshold(2.0, quantile=0.75))
    np.testing.assert_allclose(x0, [[[0.5, -1.0], [2.0, -2.0]]])
    np.testing.assert_allclose(bounded(x, [[True, True]], Threshold(5.0, quantile=0.75)), np.clip(x, -5, 5))


@pytest.mark.parametrize("garbage", [0.0, 1e9])
def test_quantiles_are_per_scene_and_of_generated_tokens(garbage):
    scenes = np.array([[[1.0, -2.0], [4.0, -8.0], [garbage] * 2], [[1.0, 1.0], [garbage] * 2, [garbage] * 2]])
    generated = np.array([[True, True, False], [True, False, False]])
    x0 = bounded(scenes, generated, Threshold(2.0, quantile=0.75))
    np.testing.assert_allclose(x0[0, :2], [[0.5, -1.0], [2.0, -2.0]])
    np.testing.assert_allclose(x0[1, 0], [1.0, 1.0])
    assert np.isfinite(bounded(scenes, generated & False, Threshold(2.0, quantile=0.75))).all()


@pytest.mark.parametrize("options", [{"bound": 0.0}, {"quantile": 0.0}, {"quantile": 1.5}])
def test_invalid_thresholds_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        Threshold(**options)
