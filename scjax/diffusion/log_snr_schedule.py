"""A noise schedule that goes on to the scale at which lanes meet, evenly in log-SNR below a deviation of 0.1.

Noise of deviation 0.025, the least of the cosine schedule, moves the end of a lane by 0.3 m
(docs/results/low_noise.md at commit 3d14608). Here a quarter of the levels lies between 0.1 and 0.005, evenly in the
logarithm of the signal-to-noise ratio, as in Karras et al. 2022 for a large rho. The others are even in the angle, as
those of the cosine schedule, up to its noisiest.

The levels are those of training, each drawn equally often, and samplers visit a subset: both spend a quarter at low
noise. With a velocity as target the loss is that of Karras et al. for data of deviation 1: c_skip = alpha,
c_out = -sigma, and x = alpha x0 + sigma eps has c_in applied; errors of x0 weigh 1 / sigma^2.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from scjax.diffusion.defaults import NUM_TRAIN_TIMESTEPS
from scjax.diffusion.noise_level import trailing_timesteps
from scjax.diffusion.schedule import DiffusionSchedule, cosine_schedule

MIN_SIGMA = 0.005
"""Deviation of the noise at the least noisy level: 6 cm of a lane's end, about the deviation of the posterior."""
KNEE = 0.1
"""Deviation of the noise below which levels are even in log-SNR."""
LOW_NOISE_SHARE = 0.25
"""Share of the levels below ``KNEE``."""


def log_snr_schedule(
    steps: int = NUM_TRAIN_TIMESTEPS, total: int = NUM_TRAIN_TIMESTEPS, last_step: float = 1.0
) -> DiffusionSchedule:
    """The schedule of training, or ``steps`` of its ``total`` levels, chosen by ``trailing_timesteps``.

    All coefficients are computed in float64: at deviation 0.005 float32 would move lanes by decimeters.

    Raises:
      ValueError: if ``steps`` is not in 2..total.
    """
    indices = trailing_timesteps(total, steps, last_step)
    sigma = noise_deviations(total)[np.arange(total) if steps == total else indices]
    cumulative = 1 - sigma**2
    previous = np.append(1.0, cumulative[:-1])
    alphas = cumulative / previous
    variance = (1 - alphas) * (1 - previous) / sigma**2
    tables = {
        "betas": 1 - alphas,
        "alphas_cumprod": cumulative,
        "alphas_cumprod_prev": previous,
        "sqrt_alphas_cumprod": np.sqrt(cumulative),
        "sqrt_one_minus_alphas_cumprod": sigma,
        "sqrt_recip_alphas_cumprod": cumulative**-0.5,
        "sqrt_recipm1_alphas_cumprod": sigma * cumulative**-0.5,
        "posterior_variance": variance,
        "posterior_log_variance_clipped": np.log(np.maximum(variance, 1e-20)),
        "posterior_mean_coef1": (1 - alphas) * np.sqrt(previous) / sigma**2,
        "posterior_mean_coef2": (1 - previous) * np.sqrt(alphas) / sigma**2,
    }
    return DiffusionSchedule(
        timesteps=cosine_time(sigma), **{name: table.astype(np.float32) for name, table in tables.items()}
    )


def noise_deviations(total: int = NUM_TRAIN_TIMESTEPS) -> Float[np.ndarray, " total"]:
    """Deviation of the noise at every level, ascending; float64."""
    low = round(LOW_NOISE_SHARE * total)
    last = np.arccos(np.sqrt(np.float64(cosine_schedule().alphas_cumprod[-1])))
    return np.append(
        np.geomspace(MIN_SIGMA, KNEE, low, endpoint=False), np.sin(np.linspace(np.arcsin(KNEE), last, total - low))
    )


def cosine_time(sigma: Float[np.ndarray, " s"]) -> Float[np.ndarray, " s"]:
    """The timestep at which the cosine schedule has this deviation, between timesteps by log-SNR; float32.

    So networks receive the same time at the same level, whichever schedule they are trained with. Below timestep 0 the
    first slope goes on: deviation 0.005 lies at about -3.
    """
    levels = cosine_schedule().levels
    knots = np.log(np.float64(levels.sigma) / np.float64(levels.alpha))
    ratio = np.log(sigma) - 0.5 * np.log1p(-(sigma**2))
    inside = np.interp(ratio, knots, np.arange(len(knots)))
    below = (ratio - knots[0]) / (knots[1] - knots[0])
    return np.where(ratio < knots[0], below, inside).astype(np.float32)
