"""DDIM: deterministic to ancestral sampling along the same noise levels."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import jax
import numpy as np

from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step, table_entry
from scjax.diffusion.samplers.threshold import Threshold, threshold_x0
from scjax.diffusion.schedule import DiffusionSchedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class DDIM(Sampler):
    """x' = alpha' x0 + sqrt(sigma'^2 - std^2) eps + std z, where std is eta times the posterior's (Song et al. 2021).

    Also known as denoising diffusion implicit models and, with eta = 0, as DPM-Solver-1 or the exponential Euler step
    of the probability-flow ODE. It is first order. It is not "DDIM inversion", which runs towards the noise. The
    default numbers of steps are not measured.

    Attributes:
      eta: 0 is deterministic after the start; 1 has the mean and variance of ``DDPM``.
      threshold: bound on the x0 estimate, from which eps is computed; None: no bound.
    """

    eta: float = 0.0
    threshold: Threshold | None = Threshold()  # noqa: RUF009 - frozen
    name: ClassVar[str] = "ddim"
    default_steps: ClassVar[Mapping[Prediction, int]] = {"noise": 50, "velocity": 50}
    last_step: ClassVar[float] = 1.0

    def __post_init__(self):
        if not 0 <= self.eta <= 1:
            raise ValueError(f"DDIM.eta must lie in 0 (deterministic)..1 (ancestral), not {self.eta}")

    def step(
        self, context: SamplingContext, x: PerType, x0: PerType, evaluation: Step, memory: tuple[()]
    ) -> tuple[PerType, tuple[()]]:
        assert isinstance(context.schedule, DiffusionSchedule)  # by ``default_steps``
        alpha, sigma, next_alpha, next_sigma = context.schedule.levels.transitions()
        std = self.eta * np.sqrt(np.asarray(context.schedule.posterior_variance, np.float64))
        x_scales = np.sqrt(np.maximum(next_sigma**2 - std**2, 0)) / sigma
        x0 = threshold_x0(x0, context.generated, self.threshold)
        x_scale, x0_scale = table_entry(x_scales, evaluation), table_entry(next_alpha - x_scales * alpha, evaluation)
        x = jax.tree.map(lambda x, x0: x_scale * x + x0_scale * x0, x, x0)
        if self.eta:
            x = jax.tree.map(lambda x, z: x + table_entry(std, evaluation) * z, x, context.step_noise(evaluation))
        return jax.tree.map(lambda x, x0: x.astype(x0.dtype), x, x0), memory
