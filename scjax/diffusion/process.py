"""The noising process on a pair of latents, what networks are to return, and the posterior of one ancestral step
(official-spec §5). A scene's agents and lanes share its level.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.schedule import Schedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType

Scale = Float[Array | np.ndarray, " b"]


def q_sample(level: NoiseLevel, clean: PerType, noise: PerType) -> PerType:
    """signal x_0 + noise eps."""
    return _combine(level.signal, clean, level.noise, noise)


def target(level: NoiseLevel, clean: PerType, noise: PerType, prediction: Prediction) -> PerType:
    """What the network is to return for ``q_sample(level, clean, noise)``.

    At the last times of the cosine schedule abar_t is about 1e-7, and x_0 hangs on a hair of the noise: a network that
    has not yet learnt to return its input there sends the sampler astray in its first step. From the velocities, x_0
    follows without division.
    """
    if prediction == "noise":
        return noise
    if prediction == "velocity":
        return _combine(level.signal, noise, -level.noise, clean)
    return jax.tree.map(jnp.subtract, noise, clean)


def estimate_x0(level: NoiseLevel, x: PerType, output: PerType, prediction: Prediction) -> PerType:
    """x_0 from x and what the network returned for it; not clipped."""
    if prediction == "velocity":
        return _combine(level.signal, x, -level.noise, output)
    if prediction == "flow":
        return _combine(jnp.ones_like(level.noise), x, -level.noise, output)
    inverse = 1 / jnp.asarray(level.signal)
    return _combine(inverse, x, -level.noise * inverse, output)


def output_for(level: NoiseLevel, x: PerType, x0: PerType, prediction: Prediction) -> PerType:
    """What the network would have to return for x to mean x_0: the inverse of ``estimate_x0`` where there is noise."""
    inverse = 1 / jnp.asarray(level.noise)
    if prediction == "flow":
        return _combine(inverse, x, -inverse, x0)
    if prediction == "velocity":
        return _combine(level.signal * inverse, x, -inverse, x0)
    return _combine(inverse, x, -level.signal * inverse, x0)


def posterior_mean(schedule: Schedule, clean: PerType, x: PerType, step: Int[Array, " b"]) -> PerType:
    """Mean of q(x_{t-1} | x_t, x_0)."""
    one, two = (jnp.asarray(x)[step] for x in (schedule.posterior_mean_coef1, schedule.posterior_mean_coef2))
    return _combine(one, clean, two, x)


def posterior_std(schedule: Schedule, step: Int[Array, " b"]) -> Float[Array, " b"]:
    """Standard deviation of q(x_{t-1} | x_t, x_0); zero for the last step (t = 0)."""
    std = jnp.exp(0.5 * jnp.asarray(schedule.posterior_log_variance_clipped)[step])
    return jnp.where(step == 0, 0, std)


def _combine(a: Scale, x: PerType, b: Scale, y: PerType) -> PerType:
    a, b = jnp.asarray(a)[:, None, None], jnp.asarray(b)[:, None, None]
    return jax.tree.map(lambda x, y: a * x + b * y, x, y)
