"""Levels of noise: x = signal x_0 + noise eps, eps ~ N(0, 1), and the levels that a sampler of few steps visits.

signal and noise are sqrt(abar_t) and sqrt(1 - abar_t) in diffusion, and 1 - s and s on the straight path of a rectified
flow.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from scjax.scene.pytree import pytree


@pytree
class NoiseLevel:
    """One level a scene [B], or the levels of a schedule [S], index 0 the least noisy.

    Attributes:
      time: what the network is told.
      signal, noise: how much of x_0 and of eps there is in x.
    """

    time: Real[Array | np.ndarray, "*n"]
    signal: Float[Array | np.ndarray, "*n"]
    noise: Float[Array | np.ndarray, "*n"]

    def __getitem__(self, step: Int[Array | np.ndarray, "*b"]) -> NoiseLevel:
        """The levels at indices of a schedule."""
        time, signal, noise = (jnp.asarray(x)[step] for x in (self.time, self.signal, self.noise))
        return NoiseLevel(time=time, signal=signal, noise=noise)

    def host(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(signal, noise) of every level of a schedule, and of the next one towards the data; NumPy, float64.

        The last step ends at the data: signal 1, noise 0.
        """
        signal, noise = np.asarray(self.signal, np.float64), np.asarray(self.noise, np.float64)
        return signal, noise, np.append(1.0, signal[:-1]), np.append(0.0, noise[:-1])


def trailing_timesteps(total: int, steps: int, last: float = 1.0) -> Int[np.ndarray, " steps"]:
    """Which of ``total`` times, 0 the least noisy, a sampler of fewer steps visits.

    Even steps down from the last time, whose state is pure noise as the sampler's start is (Lin et al. 2023,
    "trailing"). Time 0 is left out: x_0 is all but known there, so that a step to it would be lost.

    Args:
      last: length of the step that ends at the data, in those of the others. That step is of first order in any
        sampler, and half as long suits those of second order.

    Raises:
      ValueError: if ``steps`` is not in 2..total.
    """
    if not 2 <= steps <= total:
        raise ValueError(f"sampling steps must lie in 2..{total} (the steps of training), got {steps}")
    ends = total * (np.arange(steps) + last) / (steps - 1 + last)
    return np.maximum(np.round(ends).astype(int), 1) - 1
