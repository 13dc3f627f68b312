"""The schedule that goes on to low noise: its levels, exact coefficients, times, and samples of fine detail."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.log_snr_schedule import KNEE, MIN_SIGMA, cosine_time, log_snr_schedule
from scjax.diffusion.samplers import DDPM, DPMSolver, make_schedule
from scjax.diffusion.samplers.loop import sample_latents
from scjax.diffusion.schedule import DiffusionSchedule, cosine_schedule
from scjax.models.denoiser.config import DenoiserConfig
from tests.factories.sampler_oracles import LATENT_WIDTHS, MAX_TOKENS, UNIT_TEMPERATURE, token_masks


def test_a_quarter_of_the_levels_lies_evenly_in_log_snr_below_the_knee():
    sigma = np.asarray(log_snr_schedule().levels.sigma, np.float64)
    assert np.all(np.diff(sigma) > 0) and sigma[0] == np.float32(MIN_SIGMA)
    low = np.log(sigma[sigma < KNEE - 1e-6])
    assert len(low) == 25
    np.testing.assert_allclose(np.diff(low), np.log(KNEE / MIN_SIGMA) / 25, rtol=1e-4)
    np.testing.assert_allclose(log_snr_schedule().alphas_cumprod[-1], cosine_schedule().alphas_cumprod[-1], rtol=1e-4)


@pytest.mark.parametrize("steps", [100, 25, 7])
def test_posterior_keeps_signal_and_noise(steps):
    """From alpha x0 + sigma eps to alpha' x0 + sigma' eps', at every step; float32 sums would miss sigma' by much."""
    schedule = log_snr_schedule(steps)
    exact = {name: np.float64(getattr(schedule, name)) for name in ("posterior_mean_coef1", "posterior_mean_coef2")}
    first, second = exact.values()
    alpha, sigma, next_alpha, next_sigma = schedule.levels.transitions()
    np.testing.assert_allclose(first + second * alpha, next_alpha, atol=3e-7)
    variance = (second * sigma) ** 2 + np.float64(schedule.posterior_variance)
    np.testing.assert_allclose(np.sqrt(variance), next_sigma, rtol=1e-4, atol=1e-9)


def test_times_are_those_of_the_cosine_schedule_at_the_same_level():
    cosine = cosine_schedule()
    np.testing.assert_allclose(cosine_time(np.float64(cosine.levels.sigma[:-1])), np.arange(99), atol=2e-2)
    times = log_snr_schedule().timesteps
    assert np.all(np.diff(times) > 0) and -4 < times[0] < -2 and abs(times[-1] - 99) < 0.1


def spread_of_samples(schedule: DiffusionSchedule, std: float) -> float:
    """Deviation of DDPM samples by the exact denoiser of x0 ~ N(0.7, std^2)."""
    levels = schedule.levels

    def denoise(z, t):
        level = levels[jnp.searchsorted(jnp.asarray(levels.time), t)]
        alpha, sigma = level.alpha[:, None, None], level.sigma[:, None, None]

        def velocity(x):
            x0 = 0.7 + alpha * std**2 / (alpha**2 * std**2 + sigma**2) * (x - alpha * 0.7)
            return (alpha * x - x0) / sigma

        return jax.tree.map(velocity, z)

    keys = jax.random.split(jax.random.key(0), 64)
    masks = token_masks([(7, 9)] * 64)
    options = {"latent_widths": LATENT_WIDTHS, "max_tokens": MAX_TOKENS, "temperature": UNIT_TEMPERATURE}
    samples = jax.jit(lambda keys: sample_latents(denoise, schedule, keys, masks, prediction="velocity", **options))
    return float(np.std(samples(keys).lanes))


def test_samples_have_details_that_the_cosine_schedule_loses():
    std = 0.02  # 0.2 m of a lane's end
    cosine, low_noise = (make_schedule(DDPM(), "velocity", 25, schedule) for schedule in ("cosine", "log_snr"))
    assert isinstance(cosine, DiffusionSchedule) and isinstance(low_noise, DiffusionSchedule)
    assert spread_of_samples(cosine, std) < 0.5 * std
    assert 0.75 * std < spread_of_samples(low_noise, std) < 1.05 * std


def test_samplers_of_second_order_take_half_a_last_step():
    whole, half = (make_schedule(sampler, "velocity", 25, "log_snr") for sampler in (DDPM(), DPMSolver()))
    assert half.levels.sigma[0] < whole.levels.sigma[0]


@pytest.mark.parametrize("prediction", ["noise", "flow"])
def test_other_targets_are_refused(prediction):
    with pytest.raises(ValueError, match="velocity"):
        DenoiserConfig.preset("tiny", prediction=prediction, schedule="log_snr")


def test_official_preset_has_the_cosine_schedule():
    assert DenoiserConfig.preset("official").schedule == "cosine"
