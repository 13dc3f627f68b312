"""Euler and Heun for rectified flows: dx / ds = network(x, s), from noise at s = 1 to data at s = 0."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step, table_entry
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class Euler(Sampler):
    """Explicit Euler steps along the velocity: first order, one evaluation per step (Liu et al. 2023).

    Also known as ``FlowMatchEulerDiscreteScheduler`` in diffusers. It is not the "Euler ancestral" sampler, which adds
    noise in every step. The default number of steps is not measured.
    """

    name: ClassVar[str] = "euler"
    default_steps: ClassVar[Mapping[Prediction, int]] = {"flow": 50}
    last_step: ClassVar[float] = 1.0

    def step(
        self, context: SamplingContext, x: PerType, x0: PerType, evaluation: Step, memory: tuple[()]
    ) -> tuple[PerType, tuple[()]]:
        return _euler_step(x, _velocity(context, x, x0, evaluation), _step_length(context, evaluation)), memory


@dataclasses.dataclass(frozen=True)
class Heun(Sampler):
    """Heun steps along the velocity: second order, two evaluations per step.

    Also known as the improved Euler or explicit trapezoidal method: the velocity is the mean at both ends of a step.
    The last step is an Euler step, as in Karras et al. 2022: the network is not trained at s = 0. It has no stochastic
    "churn". The default number of steps is not measured.
    """

    name: ClassVar[str] = "heun"
    default_steps: ClassVar[Mapping[Prediction, int]] = {"flow": 25}
    last_step: ClassVar[float] = 0.5

    def evaluated_levels(self, steps: int) -> Int[np.ndarray, " evaluations"]:
        """Two a step, at its start and at its end; one in the last step."""
        return np.arange(2 * steps - 1) // 2

    def init_memory(self, x: PerType) -> tuple[PerType, PerType]:
        zeros = jax.tree.map(jnp.zeros_like, x)
        return zeros, zeros

    def step(
        self, context: SamplingContext, x: PerType, x0: PerType, evaluation: Step, memory: tuple[PerType, PerType]
    ) -> tuple[PerType, tuple[PerType, PerType]]:
        """The memory is the latents and the velocity at the start of the step.

        Even evaluations are at the start of step ``evaluation / 2``, odd ones at the end of the step above.
        """
        at_start, level, step = evaluation % 2 == 0, evaluation // 2, (evaluation + 1) // 2
        velocity = _velocity(context, x, x0, level)

        def choose(start: PerType, end: PerType) -> PerType:
            return jax.tree.map(lambda a, b: jnp.where(at_start, a, b), start, end)

        mean = jax.tree.map(lambda v, w: (v + w) / 2, memory[1], velocity)
        start, velocity = choose(x, memory[0]), choose(velocity, mean)
        return _euler_step(start, velocity, _step_length(context, step)), (start, velocity)


def _velocity(context: SamplingContext, x: PerType, x0: PerType, level: Step) -> PerType:
    """The network's estimate of eps - x0."""
    inverse = 1 / table_entry(np.asarray(context.schedule.levels.sigma), level)
    return jax.tree.map(lambda x, x0: (inverse * (x - x0)).astype(x.dtype), x, x0)


def _step_length(context: SamplingContext, step: Step) -> Float[Array, ""]:
    """Change of s over the step; negative."""
    levels = context.schedule.levels.transitions()
    return table_entry(levels.next_sigma - levels.sigma, step)


def _euler_step(x: PerType, velocity: PerType, length: Float[Array, ""]) -> PerType:
    return jax.tree.map(lambda x, v: (x + length * v).astype(x.dtype), x, velocity)
