"""The diffusion process on a pair of latents: noising, and the posterior of one denoising step (official-spec §5).

``step`` [B] indexes the schedule, one a scene, shared by its agents and lanes.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from scjax.diffusion.schedule import Schedule
from scjax.models.denoiser.config import Prediction
from scjax.models.nodes import Nodes


def q_sample(schedule: Schedule, clean: Nodes, noise: Nodes, step: Int[Array, " b"]) -> Nodes:
    """sqrt(abar_t) x_0 + sqrt(1 - abar_t) noise."""
    return _combine(schedule.sqrt_alphas_cumprod, clean, schedule.sqrt_one_minus_alphas_cumprod, noise, step)


def predict_x0(schedule: Schedule, x: Nodes, eps: Nodes, step: Int[Array, " b"]) -> Nodes:
    """sqrt(1 / abar_t) x_t - sqrt(1 / abar_t - 1) eps; not clipped."""
    return _combine(schedule.sqrt_recip_alphas_cumprod, x, -schedule.sqrt_recipm1_alphas_cumprod, eps, step)


def target(schedule: Schedule, clean: Nodes, noise: Nodes, step: Int[Array, " b"], prediction: Prediction) -> Nodes:
    """What the network is to return for ``q_sample(schedule, clean, noise, step)``.

    At the last times abar_t is about 1e-7, and x_0 hangs on a hair of the noise: a network that has not yet learnt to
    return its input there sends the sampler astray in its first step. From the velocity, x_0 follows without division.
    """
    if prediction == "noise":
        return noise
    return _combine(schedule.sqrt_alphas_cumprod, noise, -schedule.sqrt_one_minus_alphas_cumprod, clean, step)


def estimate_x0(schedule: Schedule, x: Nodes, output: Nodes, step: Int[Array, " b"], prediction: Prediction) -> Nodes:
    """x_0 from x_t and what the network returned for it; not clipped."""
    if prediction == "noise":
        return predict_x0(schedule, x, output, step)
    return _combine(schedule.sqrt_alphas_cumprod, x, -schedule.sqrt_one_minus_alphas_cumprod, output, step)


def posterior_mean(schedule: Schedule, clean: Nodes, x: Nodes, step: Int[Array, " b"]) -> Nodes:
    """Mean of q(x_{t-1} | x_t, x_0)."""
    return _combine(schedule.posterior_mean_coef1, clean, schedule.posterior_mean_coef2, x, step)


def posterior_std(schedule: Schedule, step: Int[Array, " b"]) -> Float[Array, " b"]:
    """Standard deviation of q(x_{t-1} | x_t, x_0); zero for the last step (t = 0)."""
    std = jnp.exp(0.5 * jnp.asarray(schedule.posterior_log_variance_clipped)[step])
    return jnp.where(step == 0, 0, std)


def _combine(a, x: Nodes, b, y: Nodes, step: Int[Array, " b"]) -> Nodes:
    a, b = (jnp.asarray(coefficients)[step][:, None, None] for coefficients in (a, b))
    return jax.tree.map(lambda x, y: a * x + b * y, x, y)
