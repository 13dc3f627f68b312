"""Rectified flow: the straight path x_s = (1 - s) x0 + s eps with velocity eps - x0 (Liu et al. 2023).

s runs from 0 (data) to 1 (noise). The network receives the time T s - 1, where T is the number of timesteps: timestep t
lies at s = (t + 1) / T, the last timestep is pure noise, and continuous times lie between the timesteps.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scjax.diffusion.defaults import NUM_TRAIN_TIMESTEPS
from scjax.diffusion.noise_level import NoiseLevel, trailing_timesteps
from scjax.scene.pytree import pytree


@pytree
class FlowSchedule:
    """Levels [S] that a sampler visits, index 0 the least noisy."""

    levels: NoiseLevel

    @property
    def steps(self) -> int:
        """Number of steps S."""
        return len(self.levels.time)


def flow_schedule(steps: int, total: int = NUM_TRAIN_TIMESTEPS, last_step: float = 1.0) -> FlowSchedule:
    """The levels of ``steps`` timesteps out of ``total``; ``last_step`` and errors as in ``trailing_timesteps``."""
    times = trailing_timesteps(total, steps, last_step)
    sigma = (times + 1) / np.float32(total)
    level = NoiseLevel(
        time=times.astype(np.int32), alpha=(1 - sigma).astype(np.float32), sigma=sigma.astype(np.float32)
    )
    return FlowSchedule(levels=level)


def flow_level(s: Float[Array, " b"], total: int = NUM_TRAIN_TIMESTEPS) -> NoiseLevel:
    """Noise levels at any s in 0..1, also between the timesteps."""
    return NoiseLevel(time=jnp.asarray(total * s - 1), alpha=1 - s, sigma=s)
