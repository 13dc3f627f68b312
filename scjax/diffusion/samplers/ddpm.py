"""DDPM: ancestral sampling, the reference sampler of the paper."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp

from scjax.diffusion.defaults import NUM_TRAIN_TIMESTEPS
from scjax.diffusion.process import posterior_mean, posterior_std
from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step
from scjax.diffusion.schedule import DiffusionSchedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class DDPM(Sampler):
    """Ancestral sampling: samples q(x_{t-1} | x_t, x0) at the estimated x0 (Ho et al. 2020, spec §5.3).

    Also known as the ancestral sampler, or DDIM with eta = 1. With all 100 steps, lane temperature 0.75 and the state
    clipped to +-5 it is the sampler of the official release. It uses the posterior variance beta-tilde, not beta, and
    neither learns the variance nor clips the x0 estimate.

    The 25 steps for a velocity were the fewest whose scenes showed no significant difference from 100 steps in any
    metric, on an earlier model (docs/results/sampling_steps.md at commit 65928e5). The number for noise is that of the
    release.
    """

    name: ClassVar[str] = "ddpm"
    default_steps: ClassVar[Mapping[Prediction, int]] = {"noise": NUM_TRAIN_TIMESTEPS, "velocity": 25}
    last_step: ClassVar[float] = 1.0

    def step(
        self, context: SamplingContext, x: PerType, x0: PerType, evaluation: Step, memory: tuple[()]
    ) -> tuple[PerType, tuple[()]]:
        assert isinstance(context.schedule, DiffusionSchedule)  # by ``default_steps``
        steps = jnp.broadcast_to(evaluation, x.agents.shape[:1])
        mean = posterior_mean(context.schedule, x0, x, steps)
        std = posterior_std(context.schedule, steps)[:, None, None]
        return jax.tree.map(lambda m, n: m + (std * n).astype(m.dtype), mean, context.step_noise(evaluation)), memory
