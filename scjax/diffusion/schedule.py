"""The coefficients of a noise schedule, and the cosine schedule (official-spec §5.1)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Array, Float, Real

from scjax.diffusion.defaults import NUM_TRAIN_TIMESTEPS
from scjax.diffusion.noise_level import NoiseLevel, trailing_timesteps
from scjax.scene.pytree import pytree


@pytree
class DiffusionSchedule:
    """Coefficients of S diffusion steps, index 0 the least noisy; names as in Ho et al. 2020; float32.

    ``timesteps`` [S] are the times that the network receives: 0..S-1, a subset of them after ``respace``, or times
    between them (``log_snr_schedule``).
    """

    timesteps: Real[Array | np.ndarray, " s"]
    betas: Float[Array | np.ndarray, " s"]
    alphas_cumprod: Float[Array | np.ndarray, " s"]
    alphas_cumprod_prev: Float[Array | np.ndarray, " s"]
    sqrt_alphas_cumprod: Float[Array | np.ndarray, " s"]
    sqrt_one_minus_alphas_cumprod: Float[Array | np.ndarray, " s"]
    sqrt_recip_alphas_cumprod: Float[Array | np.ndarray, " s"]
    sqrt_recipm1_alphas_cumprod: Float[Array | np.ndarray, " s"]
    posterior_variance: Float[Array | np.ndarray, " s"]
    posterior_log_variance_clipped: Float[Array | np.ndarray, " s"]
    posterior_mean_coef1: Float[Array | np.ndarray, " s"]
    posterior_mean_coef2: Float[Array | np.ndarray, " s"]

    @property
    def steps(self) -> int:
        """Number of steps S."""
        return len(self.timesteps)

    @property
    def levels(self) -> NoiseLevel:
        """Noise level of every step [S]."""
        return NoiseLevel(time=self.timesteps, alpha=self.sqrt_alphas_cumprod, sigma=self.sqrt_one_minus_alphas_cumprod)


def cosine_schedule(steps: int = NUM_TRAIN_TIMESTEPS) -> DiffusionSchedule:
    """beta_t = clip(1 - f_{t+1} / f_t, 0, 0.999), f the squared cosine with offset 0.008 (Nichol & Dhariwal 2021).

    As in the official release, only beta is computed in float64. All other coefficients follow from beta in float32.

    Raises:
      ValueError: on fewer than 2 steps.
    """
    if steps < 2:
        raise ValueError(f"a schedule needs at least 2 steps, got {steps}")
    x = np.linspace(0, steps + 1, steps + 1, dtype=np.float64)
    f = np.cos((x / (steps + 1) + 0.008) / 1.008 * np.pi / 2) ** 2
    cumulative = f / f[0]
    betas = np.clip(1 - cumulative[1:] / cumulative[:-1], 0, 0.999).astype(np.float32)
    alphas = np.float32(1) - betas
    cumulative = np.cumprod(alphas, dtype=np.float64).astype(np.float32)
    return _schedule_from_betas(np.arange(steps), betas, alphas, cumulative)


def respace(
    schedule: DiffusionSchedule, steps: int, last_step: float = 1.0, min_alpha: float = 0.0
) -> DiffusionSchedule:
    """Subset of the timesteps, chosen by ``trailing_timesteps``, with the betas between them.

    Also known as timestep respacing (Nichol & Dhariwal 2021). A subset of all timesteps is the schedule itself.

    Args:
      steps: number of timesteps of the subset.
      last_step: as in ``trailing_timesteps``.
      min_alpha: timesteps with a smaller sqrt(alphas_cumprod) are left out, as far as ``steps`` allows.

    Raises:
      ValueError: if ``steps`` is not in 2..S.
    """
    indices = trailing_timesteps(schedule.steps, steps, last_step)
    if steps == schedule.steps:
        return schedule
    usable = int((np.asarray(schedule.sqrt_alphas_cumprod) >= min_alpha).sum())
    indices = trailing_timesteps(max(usable, steps), steps, last_step)
    cumulative = np.asarray(schedule.alphas_cumprod)[indices]
    exact = cumulative.astype(np.float64)
    alphas = exact / np.concatenate([[1.0], exact[:-1]])
    times = np.asarray(schedule.timesteps)[indices]
    return _schedule_from_betas(times, (1 - alphas).astype(np.float32), alphas.astype(np.float32), cumulative)


def _schedule_from_betas(
    timesteps: np.ndarray, betas: np.ndarray, alphas: np.ndarray, cumulative: np.ndarray
) -> DiffusionSchedule:
    one = np.float32(1)
    previous = np.concatenate([[one], cumulative[:-1]])
    variance = betas * (one - previous) / (one - cumulative)
    return DiffusionSchedule(
        timesteps=timesteps.astype(np.int32),
        betas=betas,
        alphas_cumprod=cumulative,
        alphas_cumprod_prev=previous,
        sqrt_alphas_cumprod=np.sqrt(cumulative),
        sqrt_one_minus_alphas_cumprod=np.sqrt(one - cumulative),
        sqrt_recip_alphas_cumprod=np.sqrt(one / cumulative),
        sqrt_recipm1_alphas_cumprod=np.sqrt(one / cumulative - one),
        posterior_variance=variance,
        posterior_log_variance_clipped=np.log(np.maximum(variance, np.float32(1e-20))),
        posterior_mean_coef1=betas * np.sqrt(previous) / (one - cumulative),
        posterior_mean_coef2=(one - previous) * np.sqrt(alphas) / (one - cumulative),
    )
