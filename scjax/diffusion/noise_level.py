"""Noise levels x = alpha x0 + sigma eps, eps ~ N(0, 1), and the subset of timesteps that a sampler visits.

In diffusion, alpha = sqrt(alphas_cumprod) and sigma = sqrt(1 - alphas_cumprod). On the straight path of a rectified
flow, alpha = 1 - s and sigma = s.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from scjax.scene.pytree import pytree


class Transitions(NamedTuple):
    """Levels of all steps of a sampler and the level after each step; NumPy float64 [S], index 0 is the last step.

    The last step ends at the data: next_alpha 1, next_sigma 0.
    """

    alpha: Float[np.ndarray, " s"]
    sigma: Float[np.ndarray, " s"]
    next_alpha: Float[np.ndarray, " s"]
    next_sigma: Float[np.ndarray, " s"]


@pytree
class NoiseLevel:
    """One level per scene [B], or the levels of a schedule [S], index 0 the least noisy.

    Attributes:
      time: timestep that the network receives.
      alpha: scale of x0 in x.
      sigma: scale of the noise in x.
    """

    time: Real[Array | np.ndarray, "*n"]
    alpha: Float[Array | np.ndarray, "*n"]
    sigma: Float[Array | np.ndarray, "*n"]

    def __getitem__(self, step: Int[Array | np.ndarray, "*b"]) -> NoiseLevel:
        """The levels at indices of a schedule."""
        time, alpha, sigma = (jnp.asarray(x)[step] for x in (self.time, self.alpha, self.sigma))
        return NoiseLevel(time=time, alpha=alpha, sigma=sigma)

    def transitions(self) -> Transitions:
        """Levels before and after every step. For levels [S] of a schedule that are not traced."""
        alpha, sigma = np.asarray(self.alpha, np.float64), np.asarray(self.sigma, np.float64)
        return Transitions(alpha, sigma, np.append(1.0, alpha[:-1]), np.append(0.0, sigma[:-1]))


def trailing_timesteps(total: int, steps: int, last_step: float = 1.0) -> Int[np.ndarray, " steps"]:
    """Indices [steps] of the timesteps, out of ``total`` (0 the least noisy), that a sampler visits.

    The spacing is even and starts at the last timestep, which is pure noise like the sampler's start ("trailing"
    spacing, Lin et al. 2023). Timestep 0 is left out: x0 is almost known there, so the step would be wasted.

    Args:
      last_step: length of the step that ends at the data, relative to the other steps. This step is first order in
        every sampler. Samplers of second order use half a step.

    Raises:
      ValueError: if ``steps`` is not in 2..total.
    """
    if not 2 <= steps <= total:
        raise ValueError(f"sampling steps must lie in 2..{total} (the steps of training), got {steps}")
    ends = total * (np.arange(steps) + last_step) / (steps - 1 + last_step)
    return np.maximum(np.round(ends).astype(int), 1) - 1
