"""Rectified flow: the straight path x_s = (1 - s) x_0 + s eps, whose velocity is eps - x_0 (Liu et al. 2023).

s runs from 0 (data) to 1 (noise). The network is told the time T s - 1, so that timestep t of T is s = (t + 1) / T: the
last one is pure noise, and times in between are those between the timesteps.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scjax.diffusion.noise_level import NoiseLevel, trailing_timesteps
from scjax.diffusion.schedule import OFFICIAL_STEPS
from scjax.scene.pytree import pytree


@pytree
class FlowSchedule:
    """Levels [S] that a sampler visits, index 0 the least noisy."""

    levels: NoiseLevel

    @property
    def steps(self) -> int:
        """S."""
        return len(self.levels.time)


def flow_schedule(steps: int, total: int = OFFICIAL_STEPS, last: float = 1.0) -> FlowSchedule:
    """The levels of ``steps`` timesteps out of ``total``; ``last`` and errors as in ``trailing_timesteps``."""
    times = trailing_timesteps(total, steps, last)
    noise = (times + 1) / np.float32(total)
    level = NoiseLevel(
        time=times.astype(np.int32), signal=(1 - noise).astype(np.float32), noise=noise.astype(np.float32)
    )
    return FlowSchedule(levels=level)


def flow_level(s: Float[Array, " b"], total: int = OFFICIAL_STEPS) -> NoiseLevel:
    """Any levels s, also between the timesteps."""
    return NoiseLevel(time=jnp.asarray(total * s - 1), signal=1 - s, noise=s)
