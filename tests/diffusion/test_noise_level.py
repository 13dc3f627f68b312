"""The timesteps that a sampler of few steps visits."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.diffusion.noise_level import trailing_timesteps


def test_timesteps_are_even_from_the_noisiest_down():
    np.testing.assert_array_equal(trailing_timesteps(100, 4), [24, 49, 74, 99])
    np.testing.assert_array_equal(trailing_timesteps(100, 100), np.arange(100))
    np.testing.assert_array_equal(trailing_timesteps(100, 100, last_step=0.5), np.arange(100))


@pytest.mark.parametrize("last_step", [1.0, 0.5])
def test_every_number_of_steps_has_distinct_timesteps(last_step):
    for steps in range(2, 101):
        times = trailing_timesteps(100, steps, last_step)
        assert len(times) == steps and times[-1] == 99 and times[0] >= 0 and (np.diff(times) > 0).all(), steps
        lengths = np.diff(times, prepend=-1)
        assert np.ptp(lengths[1:]) <= 1 and abs(lengths[0] - last_step * 100 / (steps - 1 + last_step)) <= 0.51, steps


@pytest.mark.parametrize("steps", [0, 1, 101])
def test_step_counts_out_of_range_are_refused(steps):
    with pytest.raises(ValueError, match=r"2\.\.100"):
        trailing_timesteps(100, steps)
