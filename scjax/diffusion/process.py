"""The noising process, the network's prediction target, and the posterior of one ancestral step (official-spec §5).

All functions work on latents [B, tokens, latent] per type. The agents and lanes of a scene share one noise level.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.schedule import DiffusionSchedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType

Scale = Float[Array | np.ndarray, " b"]


def q_sample(level: NoiseLevel, clean: PerType, noise: PerType) -> PerType:
    """Noisy latents alpha x0 + sigma eps; a sample of q(x_t | x0) in Ho et al. 2020."""
    return _linear_combination(level.alpha, clean, level.sigma, noise)


def prediction_target(level: NoiseLevel, clean: PerType, noise: PerType, prediction: Prediction) -> PerType:
    """Output that the network should return for ``q_sample(level, clean, noise)``.

    noise: eps; velocity: alpha eps - sigma x0 (Salimans & Ho 2022); flow: eps - x0.

    At the last timesteps of the cosine schedule, alphas_cumprod is about 1e-7 and a noise prediction says almost
    nothing about x0. A network that does not yet return its input there misleads the sampler in its first step. The
    two velocities give x0 without a division.
    """
    if prediction == "noise":
        return noise
    if prediction == "velocity":
        return _linear_combination(level.alpha, noise, -level.sigma, clean)
    return jax.tree.map(jnp.subtract, noise, clean)


def estimate_x0(level: NoiseLevel, x: PerType, output: PerType, prediction: Prediction) -> PerType:
    """Estimate of x0 from x and the network's output; not clipped."""
    if prediction == "velocity":
        return _linear_combination(level.alpha, x, -level.sigma, output)
    if prediction == "flow":
        return _linear_combination(jnp.ones_like(level.sigma), x, -level.sigma, output)
    inverse = 1 / jnp.asarray(level.alpha)
    return _linear_combination(inverse, x, -level.sigma * inverse, output)


def posterior_mean(schedule: DiffusionSchedule, clean: PerType, x: PerType, step: Int[Array, " b"]) -> PerType:
    """Mean of q(x_{t-1} | x_t, x0)."""
    clean_scale, x_scale = (
        jnp.asarray(x)[step] for x in (schedule.posterior_mean_coef1, schedule.posterior_mean_coef2)
    )
    return _linear_combination(clean_scale, clean, x_scale, x)


def posterior_std(schedule: DiffusionSchedule, step: Int[Array, " b"]) -> Float[Array, " b"]:
    """Standard deviation of q(x_{t-1} | x_t, x0); zero at step 0."""
    std = jnp.exp(0.5 * jnp.asarray(schedule.posterior_log_variance_clipped)[step])
    return jnp.where(step == 0, 0, std)


def _linear_combination(a: Scale, x: PerType, b: Scale, y: PerType) -> PerType:
    a, b = jnp.asarray(a)[:, None, None], jnp.asarray(b)[:, None, None]
    return jax.tree.map(lambda x, y: a * x + b * y, x, y)
