"""The training loss of a denoiser on held-out scenes, at equal noise for all conditions.

Samples vary so much that the effect of a condition shows only in many of them. Losses at equal noise differ only by the
condition.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scjax.data.token_order import sort_tokens
from scjax.diffusion.denoise_fn import denoise_fn, prepare_denoiser_inputs
from scjax.diffusion.loss import diffusion_loss
from scjax.diffusion.schedule import cosine_schedule
from scjax.diffusion.timestep_sampling import noise_level_at
from scjax.generate.batching import padded_size
from scjax.generate.conditions import Condition
from scjax.generate.encode import network_inputs
from scjax.generate.model import Model
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.model import autoencoder
from scjax.models.codec import SceneCodec
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.nn.cpu.backend import fast_compile_options
from scjax.scene import Scene, stack
from scjax.scene.per_type import PerType

TIMES = (12, 37, 62, 87)  # of 0..99: the middles of four equal parts
_BATCH = 16  # scenes per compiled call


def denoising_losses(
    model: Model,
    scenes: Sequence[Scene],
    conditions: Sequence[Condition],
    seed: int,
    least: tuple[int, int] = (0, 0),
) -> Float[np.ndarray, " scenes"]:
    """The training loss (official-spec §5.2) of every scene under its condition, a mean over ``TIMES``.

    Equal seeds give equal noise at the same position of the list, whatever the condition. No element is known, and no
    condition is dropped. Scenes are padded to ``least`` (agents, lanes) at least.

    Raises:
      ValueError: a scene has more elements than the largest bucket of ``scjax.sample``.
    """
    config = model.denoiser.config
    encode, run = _encoder(model.codec, model.autoencoder.config), _program(model.codec, config)
    # All at once: texts get one length, so one program serves all batches.
    features, _ = network_inputs([condition.streams for condition in conditions], config.condition)
    groups: dict[tuple[int, int], list[int]] = {}
    for row, scene in enumerate(scenes):
        groups.setdefault(padded_size(int(scene.num_agents), int(scene.num_lanes), least), []).append(row)
    losses_by_scene = np.zeros(len(scenes))
    for bucket, members in groups.items():
        for start in range(0, len(members), _BATCH):
            part = members[start : start + _BATCH]
            rows = np.array(part + [part[0]] * (_BATCH - len(part)))
            batch = stack([sort_tokens(scenes[row])[0] for row in rows], bucket)
            keys = jax.vmap(functools.partial(jax.random.fold_in, jax.random.key(seed)))(rows)
            mine = jax.tree.map(lambda x: x[rows], features)  # noqa: B023 - used here
            clean = encode(model.autoencoder.params, model.latents.mean, model.latents.std, batch)
            losses = run(model.denoiser.params, clean, batch, mine, keys)
            losses_by_scene[part] = np.asarray(losses)[: len(part)]
    return losses_by_scene


@functools.lru_cache(maxsize=8)
def _encoder(codec: SceneCodec, config: AutoencoderConfig) -> Callable[..., PerType]:
    """(parameters, mean and deviation of latents, scenes) -> normalized latents: one program for all mechanisms."""
    coder = autoencoder(config)

    @functools.partial(jax.jit, compiler_options=fast_compile_options())
    def encode(params, mean, std, scenes: Scene) -> PerType:
        latents = coder.apply(params, codec.normalize(scenes), method="encode").mean
        return jax.tree.map(lambda z, m, s: (z - m) / s, latents, mean, std)

    return encode


@functools.lru_cache(maxsize=8)
def _program(codec: SceneCodec, config: DenoiserConfig) -> Callable[..., Array]:
    network, schedule = denoiser(config), cosine_schedule()

    @functools.partial(jax.jit, compiler_options=fast_compile_options())
    def run(params, clean: PerType, scenes: Scene, features, keys):
        tokens = codec.normalize(scenes)
        masks = PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask)
        label = config.domains * tokens.crop + tokens.domain
        times = np.array(TIMES)
        inputs = prepare_denoiser_inputs(
            network, config, params, label, masks, times=times, guided=False, features=features
        )
        denoise = denoise_fn(network, params, inputs, times=times)

        def normal_noise(key: Array, like: PerType) -> PerType:
            keys_by_type = PerType(agents=jax.random.fold_in(key, 0), lanes=jax.random.fold_in(key, 1))
            return jax.tree.map(lambda k, x: jax.random.normal(k, x.shape), keys_by_type, like)

        def at(time: Array) -> Array:
            noise = jax.vmap(normal_noise)(jax.vmap(lambda key: jax.random.fold_in(key, time))(keys), clean)
            level = noise_level_at(jnp.full(label.shape, time), schedule, config.prediction)
            none = jax.tree.map(jnp.zeros_like, masks)
            return diffusion_loss(denoise, level, clean, noise, masks, none, prediction=config.prediction)[1]["total"]

        return jax.lax.map(at, jnp.asarray(times)).mean(0)  # the network is compiled once, not for every time

    return run
