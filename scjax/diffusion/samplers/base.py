"""The sampler protocol: from an x0 estimate at one noise level to the latents at the next one towards the data.

The network is evaluated between two steps, not inside of one: so one compiled program of it serves every sampler.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from scjax.diffusion.flow import FlowSchedule
from scjax.diffusion.schedule import DiffusionSchedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType

Step = Int[Array, ""]
"""Index of a step in the schedule; sampling counts down to 0, the least noisy."""


class SamplingContext(NamedTuple):
    """What a sampler step needs besides latents and x0 estimates [B, tokens, latent] per type.

    Attributes:
      step_noise: step -> noise of that step, scaled by the temperature per type.
      schedule: noise levels of all steps.
      generated: True at generated tokens [B, tokens] per type: valid and not known.
    """

    step_noise: Callable[[Step], PerType]
    schedule: DiffusionSchedule | FlowSchedule
    generated: PerType


@runtime_checkable
class Sampler(Protocol):
    """A sampler: a frozen dataclass of its options.

    The defaults of the methods suit samplers that evaluate the network once per step and carry no memory.

    Attributes:
      name: name in messages and on the command line.
      default_steps: network predictions that the sampler suits -> its default number of steps.
      last_step: length of the last step relative to the others (``noise_level.trailing_timesteps``).
    """

    name: ClassVar[str]
    default_steps: ClassVar[Mapping[Prediction, int]]
    last_step: ClassVar[float]

    def evaluated_levels(self, steps: int) -> Int[np.ndarray, " evaluations"]:
        """Index of the noise level at which each evaluation of the network takes place; sampling counts down to 0."""
        return np.arange(steps)

    def init_memory(self, x: PerType) -> Any:
        """Memory before the first evaluation: a PyTree that ``step`` passes on."""
        return ()

    def step(
        self, context: SamplingContext, x: PerType, x0: PerType, evaluation: Step, memory: Any
    ) -> tuple[PerType, Any]:
        """The latents of the next evaluation, after evaluation 0 the sample; and the new memory.

        Args:
          x0: the network's x0 estimate from x, not clipped.
          evaluation: index of the evaluation; for samplers with one per step the index of the step.
        """
        ...


def table_entry(table: Float[np.ndarray, " s"], step: Step) -> Float[Array, ""]:
    """Entry ``step`` of a NumPy table [S] as float32."""
    return jnp.asarray(table, jnp.float32)[step]
