"""The compiled programs behind ``scjax.sample`` and ``scjax.reconstruct``; XLA compiles each once a padded shape."""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.diffusion.denoise_fn import make_denoise_fn
from scjax.diffusion.energies import weighted_energy
from scjax.diffusion.energy_guidance import Energy, EnergyGuidance, with_energy_guidance
from scjax.diffusion.guidance import Guidance
from scjax.diffusion.samplers import Sampler, make_schedule
from scjax.diffusion.samplers.loop import sample_latents
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.model import autoencoder
from scjax.models.codec import NormalizedScene, SceneCodec
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.nn.cpu.backend import fast_compile_options
from scjax.nn.functional import Functional, Params
from scjax.nn.sharding import spread
from scjax.scene import Scene
from scjax.scene.per_type import PerType, generated_mask

Program = Callable[..., Scene]


@functools.lru_cache(maxsize=32)
def sampling_program(
    codec: SceneCodec,
    coder_config: AutoencoderConfig,
    config: DenoiserConfig,
    sampler: Sampler,
    num_steps: int,
    guidance: Guidance | None,
    energy_guidance: EnergyGuidance | None = None,
) -> Program:
    """(parameters, latent statistics, guidance scale, temperature; a batch of requests) -> scenes in meters.

    Args:
      guidance: interval and rescaling; None is plain sampling.
      energy_guidance: None leaves the estimates as they are.
    """
    coder, network = autoencoder(coder_config), denoiser(config)
    schedule = make_schedule(sampler, config.prediction, num_steps)

    def run(
        coder_params: Params,
        params: Params,
        mean,
        std,
        scale,
        temperature,
        keys,
        masks,
        crop,
        domain,
        known_scenes,
        features,
        negative,
    ) -> Scene:
        known = known_latents = None
        if known_scenes is not None:
            tokens = codec.normalize(known_scenes)
            known = PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask)
            posterior = coder.apply(coder_params, tokens, method="encode")
            known_latents = jax.tree.map(lambda z, m, s: (z - m) / s, posterior.mean, mean, std)
        denoise = make_denoise_fn(
            network,
            config,
            params,
            config.domains * crop + domain,
            masks,
            times=schedule.levels.time,
            known=known,
            features=features,
            negative=negative,
            guidance=guidance,
            guidance_scale=scale,
        )

        def decode(latents: PerType, **options) -> Scene:
            latents = jax.tree.map(lambda z, m, s: z * s + m, latents, mean, std)
            return decode_latents(coder, coder_params, codec, latents, masks, crop, domain, **options)

        if energy_guidance is not None:
            energy = functools.partial(_energy_around, decode, energy_guidance)
            generated = generated_mask(masks, known)
            denoise = with_energy_guidance(
                denoise, schedule.levels, config.prediction, energy, generated, energy_guidance
            )
        latents = sample_latents(
            denoise,
            schedule,
            keys,
            masks,
            sampler=sampler,
            known=known,
            known_latents=known_latents,
            prediction=config.prediction,
            latent_widths=PerType(agents=config.agent_latent, lanes=config.lane_latent),
            max_tokens=PerType(agents=config.max_agents, lanes=config.max_lanes),
            temperature=temperature,
        )
        return decode(latents)

    return _compiled(run, shared=6)


def _energy_around(decode: Program, guidance: EnergyGuidance, start: PerType) -> Energy:
    """The energy of latents near ``start``, with the lane links that ``start`` decodes to."""
    links = decode(start).links  # the link head, over all pairs of lanes, would be most of a gradient step

    def energy(latents: PerType) -> Float[Array, ""]:
        scene = decode(latents, through_pairs=False).replace(links=links)
        return weighted_energy(scene, guidance.energies).sum()

    return energy


@functools.lru_cache(maxsize=8)
def reconstruction_program(codec: SceneCodec, config: AutoencoderConfig) -> Program:
    """(parameters; scenes) -> the same scenes, encoded and decoded from the posterior mean."""
    coder = autoencoder(config)

    def run(params: Params, scenes: Scene) -> Scene:
        tokens: NormalizedScene = codec.normalize(scenes)
        posterior = coder.apply(params, tokens, method="encode")
        masks = PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask)
        return decode_latents(coder, params, codec, posterior.mean, masks, tokens.crop, tokens.domain)

    return _compiled(run, shared=1)


def decode_latents(
    coder: Functional, params: Params, codec: SceneCodec, latents: PerType, masks: PerType, crop, domain, **options
) -> Scene:
    """Latents [B, tokens, latent] -> scenes in meters [B]; ``options`` are the decoder's."""
    decoded = coder.apply(params, latents, masks, method="decode", **options)
    lane_types = jnp.zeros(masks.lanes.shape, jnp.int32)
    if codec.num_lane_types:
        lane_types = decoded.lane_type_logits.argmax(-1)
    return codec.denormalize(
        decoded.agents,
        decoded.agent_type_logits.argmax(-1),
        masks.agents,
        decoded.lanes,
        lane_types,
        masks.lanes,
        decoded.link_logits,
        crop,
        domain,
    )


def _compiled(run: Program, shared: int) -> Program:
    """``run`` with its batches spread over devices (``scjax.nn.sharding.spread``); the first ``shared`` arguments are
    no batches."""
    return jax.jit(spread(run, shared=shared), compiler_options=fast_compile_options())
