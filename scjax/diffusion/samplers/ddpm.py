"""Ancestral sampling: draws from the posterior q(x_{t-1} | x_t, x_0) at the estimated x_0 (Ho et al. 2020, spec §5.3).

The reference: with all steps, temperature 0.75 of the lanes and the state clipped to +-5 it is the release's sampler.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp

from scjax.diffusion.process import posterior_mean, posterior_std
from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step
from scjax.diffusion.schedule import Schedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class DDPM(Sampler):
    """Ancestral sampling; x_0 is not clipped."""

    name: ClassVar[str] = "ddpm"
    predictions: ClassVar[tuple[Prediction, ...]] = ("noise", "velocity")
    last: ClassVar[float] = 1.0

    def step(self, problem: SamplingContext, x: PerType, step: Step, memory: tuple[()]) -> tuple[PerType, tuple[()]]:
        assert isinstance(problem.schedule, Schedule)  # by ``predictions``
        steps = jnp.broadcast_to(step, x.agents.shape[:1])
        mean = posterior_mean(problem.schedule, problem.estimate(x, step), x, steps)
        std = posterior_std(problem.schedule, steps)[:, None, None]
        return jax.tree.map(lambda m, n: m + (std * n).astype(m.dtype), mean, problem.draw(step)), memory
