"""The one loop of all samplers, around one ``denoise(z, t)`` (official-spec §5.3, outpainting §3).

Every scene has its own key, and its noise is drawn for the largest number of tokens and then cut: a scene gets the
same noise in any batch and under any padding, and the same start in any number of steps.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from scjax.diffusion.flow import FlowSchedule
from scjax.diffusion.guidance import Denoise
from scjax.diffusion.samplers.base import Sampler, SamplingContext, Step
from scjax.diffusion.samplers.ddpm import DDPM
from scjax.diffusion.samplers.threshold import BOUND
from scjax.diffusion.schedule import OFFICIAL_STEPS, Schedule
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType, generated_mask

DEFAULT_TEMPERATURE = PerType(agents=1.0, lanes=0.75)
"""The release's."""
CLIP = BOUND


def scene_noise(keys: Array, step: int | Int[Array, ""], like: PerType, most: PerType) -> PerType:
    """N(0, 1) for the latents ``like`` [B, tokens, latent], from the scenes' keys [B] and a step number.

    Args:
      most: the largest numbers of tokens (config.max_agents, config.max_lanes) whatever the padding.

    Raises:
      ValueError: a scene is padded to more tokens than ``most``.
    """

    def draw(kind: int, x: Array, rows: int) -> Array:
        if x.shape[1] > rows:
            raise ValueError(f"latents have {x.shape[1]} tokens, more than the largest number {rows}: pad less")

        def one(key: Array) -> Array:
            return jax.random.normal(jax.random.fold_in(jax.random.fold_in(key, step), kind), (rows, x.shape[2]))

        return jax.vmap(one)(keys)[:, : x.shape[1]].astype(x.dtype)

    return jax.tree.map(draw, PerType(agents=0, lanes=1), like, most)


def clamp(x: PerType, known: PerType | None, values: PerType | None) -> PerType:
    """Overwrites the tokens flagged in ``known`` [B, tokens] by ``values``, bit for bit."""
    if known is None:
        return x
    if values is None:
        raise ValueError("given tokens need their values: pass both or neither")
    return jax.tree.map(lambda flag, value, x: jnp.where(flag[..., None], value, x), known, values, x)


def sample(
    denoise: Denoise,
    schedule: Schedule | FlowSchedule,
    keys: Array,
    masks: PerType,
    *,
    widths: PerType,
    most: PerType,
    sampler: Sampler = DDPM(),  # noqa: B008 - frozen
    known: PerType | None = None,
    values: PerType | None = None,
    prediction: Prediction = "noise",
    temperature: PerType = DEFAULT_TEMPERATURE,
    clip: float | None = CLIP,
    dtype=jnp.float32,
) -> PerType:
    """Latents [B, tokens, latent] a kind, zero at padding; one ``lax.scan`` over the steps of ``schedule``.

    Args:
      denoise: (noisy latents, times [B], all equal) -> network output; guidance is a wrapper of it.
      schedule: of the sampler's steps (``samplers.schedule_of``), not traced.
      keys: one typed key a scene [B].
      masks: True at valid tokens [B, tokens] a kind.
      widths: latent numbers a token (config.agent_latent, config.lane_latent).
      most: see ``scene_noise``.
      known, values: tokens that are known and their clean latents: written over the state before the first and after
        every step. Lane-conditioned generation gives all lanes.
      prediction: what ``denoise`` estimates.
      temperature: scale of the initial and of any step noise, a kind; below 1 what is likely is drawn more often.
      clip: bound on the state after every step.
    """
    zeros = jax.tree.map(lambda mask, width: jnp.zeros((*mask.shape, width), dtype), masks, widths)

    def draw(step: int | Step) -> PerType:
        return jax.tree.map(lambda noise, scale: noise * scale, scene_noise(keys, step, zeros, most), temperature)

    def denoise_at(x: PerType, step: Step) -> PerType:
        times = jnp.broadcast_to(jnp.asarray(schedule.levels.time)[step], x.agents.shape[:1])
        return denoise(clamp(x, known, values), times)

    limit = math.inf if clip is None else clip
    problem = SamplingContext(denoise_at, draw, schedule, prediction, generated_mask(masks, known))

    def body(carry: tuple[PerType, Any], step: Array) -> tuple[tuple[PerType, Any], None]:
        x, memory = carry
        x, memory = sampler.step(problem, x, step, memory)
        x = jax.tree.map(lambda x: jnp.clip(x, -limit, limit), x)
        return (clamp(x, known, values), memory), None

    start = clamp(draw(max(schedule.steps, OFFICIAL_STEPS)), known, values)
    (x, _), _ = jax.lax.scan(body, (start, sampler.begin(start)), jnp.arange(schedule.steps - 1, -1, -1))
    return jax.tree.map(lambda x, mask: jnp.where(mask[..., None], x, 0), x, masks)
