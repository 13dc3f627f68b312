"""The sampler protocol: one step from a noise level to the next one towards the data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from scjax.diffusion.flow import FlowSchedule
from scjax.diffusion.process import estimate_x0
from scjax.diffusion.schedule import CosineSchedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType

Step = Int[Array, ""]
"""Index of a step in the schedule; sampling counts down to 0, the least noisy."""


class SamplingContext(NamedTuple):
    """What a sampler step needs besides the latents [B, tokens, latent] per type.

    Attributes:
      denoise: (latents, step) -> network output. It overwrites known tokens with their clean latents first.
      step_noise: step -> noise of that step, scaled by the temperature per type.
      schedule: noise levels of all steps.
      prediction: what the network returns.
      generated: True at generated tokens [B, tokens] per type: valid and not known.
    """

    denoise: Callable[[PerType, Step], PerType]
    step_noise: Callable[[Step], PerType]
    schedule: CosineSchedule | FlowSchedule
    prediction: Prediction
    generated: PerType

    def estimate_x0(self, x: PerType, step: Step) -> PerType:
        """The network's x0 estimate; not clipped."""
        level = self.schedule.levels[jnp.broadcast_to(step, x.agents.shape[:1])]
        return estimate_x0(level, x, self.denoise(x, step), self.prediction)


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

    def num_evaluations(self, steps: int) -> int:
        """Number of network evaluations in ``steps`` steps."""
        return steps

    def init_memory(self, x: PerType) -> Any:
        """Memory before the first step: a PyTree that ``step`` passes on."""
        return ()

    def step(self, context: SamplingContext, x: PerType, step: Step, memory: Any) -> tuple[PerType, Any]:
        """Latents at the next level, and the new memory."""
        ...


def table_entry(table: Float[np.ndarray, " s"], step: Step) -> Float[Array, ""]:
    """Entry ``step`` of a NumPy table [S] as float32."""
    return jnp.asarray(table, jnp.float32)[step]
