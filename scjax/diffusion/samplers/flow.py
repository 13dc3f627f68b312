"""Euler and Heun for rectified flows: dx / ds = network(x, s), from noise at s = 1 to data at s = 0."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import jax
from jaxtyping import Array, Float

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

    def step(self, context: SamplingContext, x: PerType, step: Step, memory: tuple[()]) -> tuple[PerType, tuple[()]]:
        return _euler_step(x, context.denoise(x, step), _step_length(context, step)), memory


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

    def num_evaluations(self, steps: int) -> int:
        return 2 * steps - 1

    def step(self, context: SamplingContext, x: PerType, step: Step, memory: tuple[()]) -> tuple[PerType, tuple[()]]:
        length, velocity = _step_length(context, step), context.denoise(x, step)
        euler = _euler_step(x, velocity, length)

        def trapezoidal() -> PerType:
            mean = jax.tree.map(lambda v, w: (v + w) / 2, velocity, context.denoise(euler, step - 1))
            return _euler_step(x, mean, length)

        return jax.lax.cond(step > 0, trapezoidal, lambda: euler), memory


def _step_length(context: SamplingContext, step: Step) -> Float[Array, ""]:
    """Change of s over the step; negative."""
    levels = context.schedule.levels.transitions()
    return table_entry(levels.next_sigma - levels.sigma, step)


def _euler_step(x: PerType, velocity: PerType, length: Float[Array, ""]) -> PerType:
    return jax.tree.map(lambda x, v: (x + length * v).astype(x.dtype), x, velocity)
