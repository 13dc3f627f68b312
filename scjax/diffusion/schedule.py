"""The cosine noise schedule and everything derived from it (official-spec §5.1)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Array, Float, Int

from scjax.diffusion.noise_level import NoiseLevel, trailing_timesteps
from scjax.scene.pytree import pytree

OFFICIAL_STEPS = 100


@pytree
class Schedule:
    """Coefficients of S diffusion steps, index 0 the least noisy; names as in Ho et al. 2020. float32.

    ``timesteps`` [S] are the times that the network is asked at: 0..S-1, or a subset of them after ``respaced``.
    """

    timesteps: Int[Array | np.ndarray, " s"]
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
        """S."""
        return len(self.timesteps)

    @property
    def levels(self) -> NoiseLevel:
        """Of every step [S]."""
        return NoiseLevel(
            time=self.timesteps, signal=self.sqrt_alphas_cumprod, noise=self.sqrt_one_minus_alphas_cumprod
        )  # fmt: skip


def cosine_schedule(steps: int = OFFICIAL_STEPS) -> Schedule:
    """beta_t = clip(1 - f_{t+1} / f_t, 0, 0.999), f the squared cosine with offset 0.008 (Nichol & Dhariwal 2021).

    As in the release, only beta is computed in float64; all else follows from its float32 rounding.
    """
    if steps < 2:
        raise ValueError(f"a schedule needs at least 2 steps, got {steps}")
    x = np.linspace(0, steps + 1, steps + 1, dtype=np.float64)
    f = np.cos((x / (steps + 1) + 0.008) / 1.008 * np.pi / 2) ** 2
    cumulative = f / f[0]
    betas = np.clip(1 - cumulative[1:] / cumulative[:-1], 0, 0.999).astype(np.float32)
    alphas = np.float32(1) - betas
    return _derived(np.arange(steps), betas, alphas, np.cumprod(alphas, dtype=np.float64).astype(np.float32))


def respaced(schedule: Schedule, steps: int, last: float = 1.0, least_signal: float = 0.0) -> Schedule:
    """Fewer sampling steps: the times of ``schedule`` that ``trailing_timesteps`` chooses, with betas between them.

    Args:
      least_signal: noisier times, whose sqrt(abar_t) is less, are left out as far as ``steps`` allows.
    """
    kept = trailing_timesteps(schedule.steps, steps, last)
    if steps == schedule.steps:
        return schedule
    usable = int((np.asarray(schedule.sqrt_alphas_cumprod) >= least_signal).sum())
    kept = trailing_timesteps(max(usable, steps), steps, last)
    cumulative = np.asarray(schedule.alphas_cumprod)[kept]
    exact = cumulative.astype(np.float64)
    alphas = exact / np.concatenate([[1.0], exact[:-1]])
    times = np.asarray(schedule.timesteps)[kept]
    return _derived(times, (1 - alphas).astype(np.float32), alphas.astype(np.float32), cumulative)


def _derived(timesteps: np.ndarray, betas: np.ndarray, alphas: np.ndarray, cumulative: np.ndarray) -> Schedule:
    one = np.float32(1)
    before = np.concatenate([[one], cumulative[:-1]])
    variance = betas * (one - before) / (one - cumulative)
    return Schedule(
        timesteps=timesteps.astype(np.int32),
        betas=betas,
        alphas_cumprod=cumulative,
        alphas_cumprod_prev=before,
        sqrt_alphas_cumprod=np.sqrt(cumulative),
        sqrt_one_minus_alphas_cumprod=np.sqrt(one - cumulative),
        sqrt_recip_alphas_cumprod=np.sqrt(one / cumulative),
        sqrt_recipm1_alphas_cumprod=np.sqrt(one / cumulative - one),
        posterior_variance=variance,
        posterior_log_variance_clipped=np.log(np.maximum(variance, np.float32(1e-20))),
        posterior_mean_coef1=betas * np.sqrt(before) / (one - cumulative),
        posterior_mean_coef2=(one - before) * np.sqrt(alphas) / (one - cumulative),
    )
