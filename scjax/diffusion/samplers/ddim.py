"""DDIM: from deterministic (eta = 0) to ancestral (eta = 1) along the same noise levels (Song et al. 2021)."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax
import numpy as np

from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step, at
from scjax.diffusion.samplers.threshold import Threshold, thresholded
from scjax.diffusion.schedule import Schedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class DDIM(Sampler):
    """x' = signal' x_0 + sqrt(noise'^2 - std^2) eps + std z, with std = eta times that of the posterior.

    Attributes:
      eta: 0 draws nothing after the start; 1 has mean and variance of ancestral sampling.
      threshold: of the estimate of x_0; eps is what then remains of x.
    """

    eta: float = 0.0
    threshold: Threshold | None = Threshold()  # noqa: RUF009 - frozen
    name: ClassVar[str] = "ddim"
    predictions: ClassVar[tuple[Prediction, ...]] = ("noise", "velocity")
    last: ClassVar[float] = 1.0

    def __post_init__(self):
        if not 0 <= self.eta <= 1:
            raise ValueError(f"DDIM.eta must lie in 0 (deterministic)..1 (ancestral), not {self.eta}")

    def step(self, problem: SamplingContext, x: PerType, step: Step, memory: tuple[()]) -> tuple[PerType, tuple[()]]:
        assert isinstance(problem.schedule, Schedule)  # by ``predictions``
        signal, noise, signal_after, noise_after = problem.schedule.levels.host()
        std = self.eta * np.sqrt(np.asarray(problem.schedule.posterior_variance, np.float64))
        keep = np.sqrt(np.maximum(noise_after**2 - std**2, 0)) / noise
        x0 = thresholded(problem.estimate(x, step), problem.generated, self.threshold)
        kept, new = at(keep, step), at(signal_after - keep * signal, step)
        x = jax.tree.map(lambda x, x0: kept * x + new * x0, x, x0)
        if self.eta:
            x = jax.tree.map(lambda x, z: x + at(std, step) * z, x, problem.draw(step))
        return jax.tree.map(lambda x, x0: x.astype(x0.dtype), x, x0), memory
