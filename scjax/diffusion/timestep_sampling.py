"""Distribution of the noise levels in training: uniform, or logit-normal (Esser et al. 2024).

A rectified flow can be trained at any level. The cosine schedule has levels only at its timesteps.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from scjax.diffusion.flow import flow_level
from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.schedule import DiffusionSchedule
from scjax.models.denoiser.config import Prediction
from scjax.nn import random

DISTRIBUTIONS = ("uniform", "logit-normal")


@dataclasses.dataclass(frozen=True)
class TimestepSampling:
    """Options of ``sample_noise_levels``.

    Attributes:
      distribution: "uniform", or "logit-normal": the sigmoid of a normal variable, which favors middle levels.
      continuous: whether a rectified flow uses any level instead of the timesteps only.
      mean, std: of the normal variable; a mean above 0 favors noisier levels.
    """

    distribution: str = "uniform"
    continuous: bool = False
    mean: float = 0.0
    std: float = 1.0

    def __post_init__(self):
        if self.distribution not in DISTRIBUTIONS:
            raise ValueError(
                f"TimestepSampling.distribution must be {' or '.join(DISTRIBUTIONS)}, not {self.distribution!r}"
            )
        if not self.std > 0:
            raise ValueError(f"TimestepSampling.std must be positive, not {self.std}")


def sample_noise_levels(
    key: Array, scenes: int, schedule: DiffusionSchedule, prediction: Prediction, sampling: TimestepSampling
) -> NoiseLevel:
    """One random noise level per scene [B].

    Args:
      scenes: B.
      schedule: the timesteps; a rectified flow uses only their number.

    Raises:
      ValueError: on continuous levels for a prediction other than "flow".
    """
    if sampling.continuous and prediction != "flow":
        raise ValueError(f"a network that estimates {prediction} knows timesteps only: leave continuous times to flow")
    total, shape = schedule.steps, (scenes,)
    if sampling.distribution == "uniform" and not sampling.continuous:
        step = random.randint(key, shape, 0, total)
    else:
        if sampling.distribution == "uniform":
            s = random.uniform(key, shape)
        else:
            s = jax.nn.sigmoid(sampling.mean + sampling.std * random.normal(key, shape))
        if sampling.continuous:
            return flow_level(s, total)
        step = jnp.minimum((s * total).astype(jnp.int32), total - 1)
    return noise_level_at(step, schedule, prediction)


def noise_level_at(step: Int[Array, " b"], schedule: DiffusionSchedule, prediction: Prediction) -> NoiseLevel:
    """Noise levels of timesteps [B]: those of the schedule or, for "flow", those of the straight path."""
    if prediction != "flow":
        return schedule.levels[step]
    level = flow_level((step + 1) / schedule.steps, schedule.steps)
    return NoiseLevel(time=step, alpha=level.alpha, sigma=level.sigma)
