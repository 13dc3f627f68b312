"""DPM-Solver++ 2M: second order from one evaluation a step, by the estimate of x_0 of the step before (Lu et al. 2022).

With lambda = log(signal / noise) and h its increase over a step, the exact solution for a constant x_0 is
x' = (noise' / noise) x + (signal' - signal noise' / noise) x_0. Second order puts x_0 + (x_0 - before) h / (2 h_before)
for x_0. The first step has no estimate before it, and the last ends at lambda = infinity: both are of first order.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step, at
from scjax.diffusion.samplers.threshold import Threshold, thresholded
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class DPMSolver(Sampler):
    """DPM-Solver++ 2M, deterministic; ``threshold`` bounds the estimate of x_0."""

    threshold: Threshold | None = Threshold()  # noqa: RUF009 - frozen
    name: ClassVar[str] = "dpm++"
    predictions: ClassVar[tuple[Prediction, ...]] = ("noise", "velocity", "flow")
    last: ClassVar[float] = 0.5

    def begin(self, x: PerType) -> PerType:
        return jax.tree.map(jnp.zeros_like, x)

    def step(self, problem: SamplingContext, x: PerType, step: Step, memory: PerType) -> tuple[PerType, PerType]:
        kept, new, further = (at(table, step) for table in coefficients(problem.schedule.levels))
        x0 = thresholded(problem.estimate(x, step), problem.generated, self.threshold)
        ahead = jax.tree.map(lambda x0, before: x0 + further * (x0 - before), x0, memory)
        return jax.tree.map(lambda x, x0: (kept * x + new * x0).astype(x.dtype), x, ahead), x0


def coefficients(
    levels: NoiseLevel,
) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, " s"], Float[np.ndarray, " s"]]:
    """Of every step: what x, x_0, and the difference to the x_0 before are multiplied with."""
    signal, noise, signal_after, noise_after = levels.host()
    with np.errstate(divide="ignore"):  # pure noise and the data lie at lambda = -infinity and infinity
        increase = np.log(signal_after) - np.log(noise_after) - np.log(signal) + np.log(noise)
    further = np.zeros(len(signal))
    further[1:-1] = increase[1:-1] / (2 * increase[2:])
    return noise_after / noise, signal_after - signal * noise_after / noise, further
