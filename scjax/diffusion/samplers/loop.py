"""The sampling loop of all samplers around the network (official-spec §5.3, outpainting §3).

Every scene has its own key. Its noise is sampled for the largest number of tokens and then cut: a scene gets the same
noise in any batch and under any padding, and the same start for any number of steps.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from scjax.diffusion.defaults import DEFAULT_LATENT_BOUND, DEFAULT_TEMPERATURE, NUM_TRAIN_TIMESTEPS
from scjax.diffusion.flow import FlowSchedule
from scjax.diffusion.guidance import Denoise
from scjax.diffusion.process import estimate_x0
from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step
from scjax.diffusion.samplers.ddpm import DDPM
from scjax.diffusion.schedule import DiffusionSchedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType, generated_mask
from scjax.scene.pytree import pytree


def scene_noise(keys: Array, step: int | Int[Array, ""], like: PerType, max_tokens: PerType) -> PerType:
    """N(0, 1) noise with the shapes of ``like`` [B, tokens, latent] per type, from one key per scene and a step number.

    Args:
      keys: one typed key per scene [B].
      max_tokens: largest numbers of tokens (config.max_agents, config.max_lanes), independent of the padding.

    Raises:
      ValueError: if a scene is padded to more tokens than ``max_tokens``.
    """

    def noise(type_index: int, x: Array, rows: int) -> Array:
        if x.shape[1] > rows:
            raise ValueError(f"latents have {x.shape[1]} tokens, more than the largest number {rows}: pad less")

        def one_scene(key: Array) -> Array:
            key = jax.random.fold_in(jax.random.fold_in(key, step), type_index)
            return jax.random.normal(key, (rows, x.shape[2]))

        return jax.vmap(one_scene)(keys)[:, : x.shape[1]].astype(x.dtype)

    return jax.tree.map(noise, PerType(agents=0, lanes=1), like, max_tokens)


def set_known(x: PerType, known: PerType | None, known_latents: PerType | None) -> PerType:
    """Overwrites the known tokens [B, tokens] of x by their clean latents, bit for bit.

    Raises:
      ValueError: if ``known`` has no ``known_latents``.
    """
    if known is None:
        return x
    if known_latents is None:
        raise ValueError("known tokens need known_latents, their clean values: pass both or neither")
    return jax.tree.map(lambda mask, clean, x: jnp.where(mask[..., None], clean, x), known, known_latents, x)


@pytree
class LoopInputs:
    """What is fixed while a batch of scenes is sampled.

    Attributes:
      keys: one typed key per scene [B].
      masks: True at valid tokens [B, tokens] per type.
      known, known_latents: known tokens [B, tokens] per type and their clean latents [B, tokens, latent]; None: none.
        They overwrite the state before the first and after every step. In lane-conditioned generation all lanes are
        known.
    """

    keys: Array
    masks: PerType
    known: PerType | None = None
    known_latents: PerType | None = None


@pytree
class LoopState:
    """Latents before an evaluation [B, tokens, latent] per type, and the sampler's memory."""

    x: PerType
    memory: Any


@dataclasses.dataclass(frozen=True)
class SamplingLoop:
    """The sampling loop without the network: its start, and the change of the state after each evaluation.

    Attributes:
      sampler, schedule: the rule of a step, and the levels of its steps (``samplers.make_schedule``); not traced.
      prediction: what the network returns.
      latent_widths: latent size per type (config.agent_latent, config.lane_latent).
      max_tokens: as in ``scene_noise``.
      clip: bound on the absolute value of the state after every evaluation; None: no bound.
    """

    sampler: Sampler
    schedule: DiffusionSchedule | FlowSchedule
    prediction: Prediction
    latent_widths: PerType
    max_tokens: PerType
    clip: float | None = DEFAULT_LATENT_BOUND
    dtype: Any = jnp.float32

    @property
    def levels(self) -> Int[np.ndarray, " evaluations"]:
        """Index of the noise level of every evaluation; sampling counts down to 0."""
        return self.sampler.evaluated_levels(self.schedule.steps)

    def start(self, inputs: LoopInputs, temperature: PerType) -> LoopState:
        """Noise, scaled by the temperature per type; below 1 it favors likely scenes."""
        noise = self._noise(inputs, temperature, max(self.schedule.steps, NUM_TRAIN_TIMESTEPS))
        x = set_known(noise, inputs.known, inputs.known_latents)
        return LoopState(x=x, memory=self.sampler.init_memory(x))

    def advance(
        self,
        inputs: LoopInputs,
        temperature: PerType,
        denoise: Denoise,
        state: LoopState,
        x0: PerType,
        first: Step,
        last: Step,
    ) -> tuple[LoopState, PerType]:
        """The state before evaluation ``last``, and its x0 estimate.

        Args:
          denoise: (noisy latents, times [B], all equal) -> network output; guidance is a wrapper around it.
          state, x0: from the evaluation before ``first``; the x0 estimate may have been changed. At the start of
            sampling, where ``first`` is the highest evaluation, ``x0`` is ignored.
          first, last: evaluations, ``first`` not below ``last``; may be traced.
        """

        def evaluate(i: Array, carry: tuple[LoopState, PerType]) -> tuple[LoopState, PerType]:
            evaluation, (before, x0) = first - i, carry
            state = jax.tree.map(
                lambda start, moved: jnp.where(evaluation + 1 == len(self.levels), start, moved),
                before,
                self.update(inputs, temperature, before, x0, evaluation + 1),
            )
            level = jnp.broadcast_to(jnp.asarray(self.levels)[evaluation], state.x.agents.shape[:1])
            output = denoise(state.x, jnp.asarray(self.schedule.levels.time)[level])
            estimate = estimate_x0(self.schedule.levels[level], state.x, output, self.prediction)
            return state, set_known(estimate, inputs.known, inputs.known_latents)

        return jax.lax.fori_loop(0, first - last + 1, evaluate, (state, x0))

    def update(
        self, inputs: LoopInputs, temperature: PerType, state: LoopState, x0: PerType, evaluation: Step
    ) -> LoopState:
        """The state after an evaluation whose x0 estimate is ``x0``."""
        context = SamplingContext(
            step_noise=lambda step: self._noise(inputs, temperature, step),
            schedule=self.schedule,
            generated=generated_mask(inputs.masks, inputs.known),
        )
        x, memory = self.sampler.step(context, state.x, x0, evaluation, state.memory)
        limit = math.inf if self.clip is None else self.clip
        x = jax.tree.map(lambda x: jnp.clip(x, -limit, limit), x)
        return LoopState(x=set_known(x, inputs.known, inputs.known_latents), memory=memory)

    def _noise(self, inputs: LoopInputs, temperature: PerType, step: int | Step) -> PerType:
        zeros = jax.tree.map(
            lambda mask, width: jnp.zeros((*mask.shape, width), self.dtype), inputs.masks, self.latent_widths
        )
        noise = scene_noise(inputs.keys, step, zeros, self.max_tokens)
        return jax.tree.map(lambda noise, scale: noise * scale, noise, temperature)


def sample_latents(
    denoise: Denoise,
    schedule: DiffusionSchedule | FlowSchedule,
    keys: Array,
    masks: PerType,
    *,
    latent_widths: PerType,
    max_tokens: PerType,
    sampler: Sampler = DDPM(),  # noqa: B008 - frozen
    known: PerType | None = None,
    known_latents: PerType | None = None,
    prediction: Prediction = "noise",
    temperature: PerType = DEFAULT_TEMPERATURE,
    clip: float | None = DEFAULT_LATENT_BOUND,
    dtype=jnp.float32,
) -> PerType:
    """Samples latents [B, tokens, latent] per type in one program.

    ``scjax.sample`` runs the same loop in several smaller programs (``scjax.generate.loop``).

    Args:
      denoise: (noisy latents, times [B], all equal) -> network output; guidance is a wrapper around it.
      keys, masks, known, known_latents: as in ``LoopInputs``.
      schedule, sampler, prediction, latent_widths, max_tokens, clip: as in ``SamplingLoop``.
      temperature: scale of the initial noise and of the noise of all steps per type.

    Returns:
      Latents, zero at padding.
    """
    loop = SamplingLoop(sampler, schedule, prediction, latent_widths, max_tokens, clip, dtype)
    inputs = LoopInputs(keys=keys, masks=masks, known=known, known_latents=known_latents)

    start, highest = loop.start(inputs, temperature), len(loop.levels) - 1
    state, x0 = loop.advance(inputs, temperature, denoise, start, start.x, jnp.int32(highest), jnp.int32(0))
    state = loop.update(inputs, temperature, state, x0, jnp.int32(0))
    return jax.tree.map(lambda x, mask: jnp.where(mask[..., None], x, 0), state.x, masks)
