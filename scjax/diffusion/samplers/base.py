"""What every sampler gets, and what it gives: one step from a level to the next one towards the data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from scjax.diffusion.flow import FlowSchedule
from scjax.diffusion.process import estimate_x0
from scjax.diffusion.schedule import Schedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType

Step = Int[Array, ""]


class SamplingContext(NamedTuple):
    """A batch of scenes to be sampled.

    Attributes:
      denoise: (latents, step) -> network output; given tokens are put in place before.
      draw: step -> noise of that step, scaled by the temperature of each kind.
      schedule: the levels; a step is an index of them, 0 the last one to be taken.
      prediction: what the network estimates.
      generated: True at the tokens that are generated: valid and not given.
    """

    denoise: Callable[[PerType, Step], PerType]
    draw: Callable[[Step], PerType]
    schedule: Schedule | FlowSchedule
    prediction: Prediction
    generated: PerType

    def estimate(self, x: PerType, step: Step) -> PerType:
        """x_0 by the network."""
        level = self.schedule.levels[jnp.broadcast_to(step, x.agents.shape[:1])]
        return estimate_x0(level, x, self.denoise(x, step), self.prediction)


@runtime_checkable
class Sampler(Protocol):
    """A sampler: a frozen dataclass of its options. Unless it says otherwise, it asks the network once a step and
    remembers nothing.

    Attributes:
      name: in messages and on the command line.
      predictions: what networks that it fits estimate.
      last: length of its last step (``level.trailing_timesteps``).
    """

    name: ClassVar[str]
    predictions: ClassVar[tuple[Prediction, ...]]
    last: ClassVar[float]

    def evaluations(self, steps: int) -> int:
        """How often the network runs in so many steps."""
        return steps

    def begin(self, x: PerType) -> Any:
        """What it remembers from step to step, before the first."""
        return ()

    def step(self, problem: SamplingContext, x: PerType, step: Step, memory: Any) -> tuple[PerType, Any]:
        """The state at the next level, and what to remember."""
        ...


def at(table, step: Step) -> Float[Array, ""]:
    """A number of a table [S] of the host."""
    return jnp.asarray(table, jnp.float32)[step]
