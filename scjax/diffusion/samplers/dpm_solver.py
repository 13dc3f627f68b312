"""DPM-Solver++ 2M: second order with one network evaluation per step."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step, table_entry
from scjax.diffusion.samplers.threshold import Threshold, threshold_x0
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType


class MultistepCoefficients(NamedTuple):
    """Factors of x, of the extrapolated x0, and of the difference to the previous x0 estimate, for every step [S]."""

    x: Float[np.ndarray, " s"]
    x0: Float[np.ndarray, " s"]
    difference: Float[np.ndarray, " s"]


@dataclasses.dataclass(frozen=True)
class DPMSolver(Sampler):
    """Deterministic two-step multistep solver for the x0 prediction (Lu et al. 2022, "DPM-Solver++").

    Also known as DPM++ 2M, or ``DPMSolverMultistepScheduler`` of order 2 in diffusers. It is not the singlestep 2S or
    3S, not the stochastic 2M SDE, and not the first DPM-Solver, which extrapolates eps. The default numbers of steps
    are not measured.

    With lambda = log(alpha / sigma) and h its increase over a step, the exact solution for a constant x0 is
    x' = (sigma' / sigma) x + (alpha' - alpha sigma' / sigma) x0. Second order replaces x0 by the extrapolation
    x0 + (x0 - previous x0) h / (2 previous h). The first step has no previous estimate, and the last one ends at
    lambda = infinity: both are first order.

    Attributes:
      threshold: bound on the x0 estimate; None: no bound.
    """

    threshold: Threshold | None = Threshold()  # noqa: RUF009 - frozen
    name: ClassVar[str] = "dpm++"
    default_steps: ClassVar[Mapping[Prediction, int]] = {"noise": 25, "velocity": 25, "flow": 25}
    last_step: ClassVar[float] = 0.5

    def init_memory(self, x: PerType) -> PerType:
        return jax.tree.map(jnp.zeros_like, x)

    def step(
        self, context: SamplingContext, x: PerType, x0: PerType, evaluation: Step, memory: PerType
    ) -> tuple[PerType, PerType]:
        """The memory is the previous x0 estimate."""
        coefficients = multistep_coefficients(context.schedule.levels)
        x_scale, x0_scale, difference_scale = (table_entry(table, evaluation) for table in coefficients)
        x0 = threshold_x0(x0, context.generated, self.threshold)
        extrapolated = jax.tree.map(lambda x0, previous: x0 + difference_scale * (x0 - previous), x0, memory)
        return jax.tree.map(lambda x, x0: (x_scale * x + x0_scale * x0).astype(x.dtype), x, extrapolated), x0


def multistep_coefficients(levels: NoiseLevel) -> MultistepCoefficients:
    """Coefficients of ``DPMSolver`` at the levels of a schedule."""
    alpha, sigma, next_alpha, next_sigma = levels.transitions()
    with np.errstate(divide="ignore"):  # pure noise and the data lie at lambda = -infinity and infinity
        increase = np.log(next_alpha) - np.log(next_sigma) - np.log(alpha) + np.log(sigma)
    difference = np.zeros(len(alpha))
    difference[1:-1] = increase[1:-1] / (2 * increase[2:])
    return MultistepCoefficients(next_sigma / sigma, next_alpha - alpha * next_sigma / sigma, difference)
