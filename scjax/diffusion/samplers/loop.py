"""The sampling loop of all samplers around one ``denoise(z, t)`` (official-spec §5.3, outpainting §3).

Every scene has its own key. Its noise is sampled for the largest number of tokens and then cut: a scene gets the same
noise in any batch and under any padding, and the same start for any number of steps.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from scjax.diffusion.defaults import DEFAULT_LATENT_BOUND, DEFAULT_TEMPERATURE, NUM_TRAIN_TIMESTEPS
from scjax.diffusion.flow import FlowSchedule
from scjax.diffusion.guidance import Denoise
from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step
from scjax.diffusion.samplers.ddpm import DDPM
from scjax.diffusion.schedule import CosineSchedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType, generated_mask


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


def sample_latents(
    denoise: Denoise,
    schedule: CosineSchedule | FlowSchedule,
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
    """Samples latents [B, tokens, latent] per type with one ``lax.scan`` over the steps of ``schedule``.

    Args:
      denoise: (noisy latents, times [B], all equal) -> network output; guidance is a wrapper around it.
      schedule: levels of the sampler's steps (``samplers.make_schedule``); not traced.
      keys: one typed key per scene [B].
      masks: True at valid tokens [B, tokens] per type.
      latent_widths: latent size per type (config.agent_latent, config.lane_latent).
      max_tokens: as in ``scene_noise``.
      known, known_latents: known tokens [B, tokens] per type and their clean latents. They overwrite the state before
        the first and after every step. In lane-conditioned generation all lanes are known.
      prediction: what ``denoise`` returns.
      temperature: scale of the initial noise and of the noise of all steps per type; below 1 favors likely scenes.
      clip: bound on the absolute value of the state after every step; None: no bound.

    Returns:
      Latents, zero at padding.
    """
    zeros = jax.tree.map(lambda mask, width: jnp.zeros((*mask.shape, width), dtype), masks, latent_widths)

    def step_noise(step: int | Step) -> PerType:
        return jax.tree.map(lambda noise, scale: noise * scale, scene_noise(keys, step, zeros, max_tokens), temperature)

    def denoise_at(x: PerType, step: Step) -> PerType:
        times = jnp.broadcast_to(jnp.asarray(schedule.levels.time)[step], x.agents.shape[:1])
        return denoise(set_known(x, known, known_latents), times)

    limit = math.inf if clip is None else clip
    context = SamplingContext(denoise_at, step_noise, schedule, prediction, generated_mask(masks, known))

    def body(carry: tuple[PerType, Any], step: Array) -> tuple[tuple[PerType, Any], None]:
        x, memory = carry
        x, memory = sampler.step(context, x, step, memory)
        x = jax.tree.map(lambda x: jnp.clip(x, -limit, limit), x)
        return (set_known(x, known, known_latents), memory), None

    start = set_known(step_noise(max(schedule.steps, NUM_TRAIN_TIMESTEPS)), known, known_latents)
    (x, _), _ = jax.lax.scan(body, (start, sampler.init_memory(start)), jnp.arange(schedule.steps - 1, -1, -1))
    return jax.tree.map(lambda x, mask: jnp.where(mask[..., None], x, 0), x, masks)
