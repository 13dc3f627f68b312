"""Euler and Heun along the velocity of a rectified flow: dx / ds = network(x, s), from noise at s = 1 to data."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import jax

from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step, at
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class Euler(Sampler):
    """First order, one evaluation a step."""

    name: ClassVar[str] = "euler"
    predictions: ClassVar[tuple[Prediction, ...]] = ("flow",)
    last: ClassVar[float] = 1.0

    def step(self, problem: SamplingContext, x: PerType, step: Step, memory: tuple[()]) -> tuple[PerType, tuple[()]]:
        return _moved(x, problem.denoise(x, step), _length(problem, step)), memory


@dataclasses.dataclass(frozen=True)
class Heun(Sampler):
    """Second order: the mean of the velocities at both ends of a step, two evaluations; the last step is Euler's.

    (As in Karras et al. 2022: at s = 0 no network was trained.)
    """

    name: ClassVar[str] = "heun"
    predictions: ClassVar[tuple[Prediction, ...]] = ("flow",)
    last: ClassVar[float] = 0.5

    def evaluations(self, steps: int) -> int:
        return 2 * steps - 1

    def step(self, problem: SamplingContext, x: PerType, step: Step, memory: tuple[()]) -> tuple[PerType, tuple[()]]:
        length, velocity = _length(problem, step), problem.denoise(x, step)
        there = _moved(x, velocity, length)

        def corrected() -> PerType:
            mean = jax.tree.map(lambda v, w: (v + w) / 2, velocity, problem.denoise(there, step - 1))
            return _moved(x, mean, length)

        return jax.lax.cond(step > 0, corrected, lambda: there), memory


def _length(problem: SamplingContext, step: Step):
    _, noise, _, noise_after = problem.schedule.levels.host()
    return at(noise_after - noise, step)


def _moved(x: PerType, velocity: PerType, length) -> PerType:
    return jax.tree.map(lambda x, v: (x + length * v).astype(x.dtype), x, velocity)
