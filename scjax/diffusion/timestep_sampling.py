"""At which levels of noise a network is trained: evenly, or mostly in the middle (logit-normal, Esser et al. 2024).

A rectified flow may be trained at any level; the cosine schedule has those of its timesteps only.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from scjax.diffusion.flow import flow_level
from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.schedule import Schedule
from scjax.models.denoiser.config import Prediction

DRAWS = ("uniform", "logit-normal")


@dataclasses.dataclass(frozen=True)
class TimestepSampling:
    """How levels are drawn.

    Attributes:
      draw: "uniform", or "logit-normal": the sigmoid of a normal variable of ``mean`` (above 0: noisier) and ``std``.
      continuous: any level of a rectified flow instead of those of the timesteps.
    """

    draw: str = "uniform"
    continuous: bool = False
    mean: float = 0.0
    std: float = 1.0

    def __post_init__(self):
        if self.draw not in DRAWS:
            raise ValueError(f"times are drawn {' or '.join(DRAWS)}, not {self.draw!r}")
        if not self.std > 0:
            raise ValueError(f"Times.std must be positive, not {self.std}")


def draw_levels(
    key: Array, scenes: int, schedule: Schedule, prediction: Prediction, times: TimestepSampling
) -> NoiseLevel:
    """A level a scene [B].

    Args:
      schedule: the timesteps; a rectified flow takes their number from it.

    Raises:
      ValueError: continuous times for a network of another prediction than "flow".
    """
    if times.continuous and prediction != "flow":
        raise ValueError(f"a network that estimates {prediction} knows timesteps only: leave continuous times to flow")
    total, shape = schedule.steps, (scenes,)
    if times.draw == "uniform" and not times.continuous:
        step = jax.random.randint(key, shape, 0, total)
    else:
        if times.draw == "uniform":
            s = jax.random.uniform(key, shape)
        else:
            s = jax.nn.sigmoid(times.mean + times.std * jax.random.normal(key, shape))
        if times.continuous:
            return flow_level(s, total)
        step = jnp.minimum((s * total).astype(jnp.int32), total - 1)
    return level_at(step, schedule, prediction)


def level_at(step: Int[Array, " b"], schedule: Schedule, prediction: Prediction) -> NoiseLevel:
    """The levels of timesteps [B]: those of the schedule, or as many of the straight path of a rectified flow."""
    if prediction != "flow":
        return schedule.levels[step]
    level = flow_level((step + 1) / schedule.steps, schedule.steps)
    return NoiseLevel(time=step, signal=level.signal, noise=level.noise)
