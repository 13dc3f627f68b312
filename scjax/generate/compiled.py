"""The compiled programs behind ``scjax.sample`` and ``scjax.reconstruct``; XLA compiles each once a padded shape.

Sampling goes from one small program to the next (``scjax.generate.loop``): each part of it is compiled once, however
often and wherever it runs.
"""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array

from scjax.diffusion.denoise_fn import DenoiserInputs, denoise_fn, prepare_denoiser_inputs
from scjax.diffusion.energies import ENERGIES
from scjax.diffusion.energy_guidance import Descent, EnergyGuidance, descend
from scjax.diffusion.guidance import Guidance
from scjax.diffusion.samplers import Sampler, make_schedule
from scjax.diffusion.samplers.loop import LoopInputs, LoopState, SamplingLoop
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.model import autoencoder, decoder
from scjax.models.codec import SceneCodec
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.models.denoiser.position_head import position_heads
from scjax.models.shared_endpoints import share_endpoints
from scjax.nn.functional import Params
from scjax.nn.stored_program import StoredProgram
from scjax.scene import Scene
from scjax.scene.per_type import PerType, generated_mask


@functools.lru_cache(maxsize=8)
def sampling_loop(sampler: Sampler, config: DenoiserConfig, num_steps: int) -> SamplingLoop:
    """The sampling loop for the latents of a denoiser."""
    return SamplingLoop(
        sampler,
        make_schedule(sampler, config.prediction, num_steps, config.schedule),
        config.prediction,
        latent_widths=PerType(agents=config.agent_latent, lanes=config.lane_latent),
        max_tokens=PerType(agents=config.max_agents, lanes=config.max_lanes),
    )


@functools.lru_cache(maxsize=8)
def encode_program(codec: SceneCodec, config: AutoencoderConfig) -> StoredProgram:
    """(parameters, mean and deviation of latents; scenes) -> masks, and normalized latents: the posterior's mean."""

    def encode(params: Params, mean: PerType, std: PerType, scenes: Scene) -> tuple[PerType, PerType]:
        tokens = codec.normalize(scenes)
        with jax.default_matmul_precision("float32"):
            posterior = autoencoder(_exact(config)).apply(params, tokens, method="encode")
        masks = PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask)
        return masks, jax.tree.map(lambda z, m, s: (z - m) / s, posterior.mean, mean, std)

    return StoredProgram(encode, shared=3, options=(codec, config))


@functools.lru_cache(maxsize=8)
def decode_program(codec: SceneCodec, config: AutoencoderConfig) -> StoredProgram:
    """(the decoder's parameters, mean and deviation of latents; normalized latents, masks, crop, domain, known scenes
    or None) -> scenes in meters."""

    def decode(
        params: Params,
        mean: PerType,
        std: PerType,
        latents: PerType,
        masks: PerType,
        crop: Array,
        domain: Array,
        known: Scene | None,
    ) -> Scene:
        latents = jax.tree.map(lambda z, m, s: z * s + m, latents, mean, std)
        with jax.default_matmul_precision("float32"):
            return decode_latents(_exact(config), params, codec, latents, masks, crop, domain, known)

    return StoredProgram(decode, shared=3, options=(codec, config))


@functools.lru_cache(maxsize=8)
def start_program(sampler: Sampler, config: DenoiserConfig, num_steps: int) -> StoredProgram:
    """(temperature; loop inputs) -> the state at the start of sampling."""
    loop = sampling_loop(sampler, config, num_steps)

    def start(temperature: PerType, inputs: LoopInputs) -> LoopState:
        return loop.start(inputs, temperature)

    return StoredProgram(start, shared=1, options=(sampler, config, num_steps), light=True)


@functools.lru_cache(maxsize=8)
def update_program(sampler: Sampler, config: DenoiserConfig, num_steps: int) -> StoredProgram:
    """(temperature, evaluation; loop inputs, state, x0 estimate) -> the next state."""
    loop = sampling_loop(sampler, config, num_steps)

    def update(temperature: PerType, evaluation: Array, inputs: LoopInputs, state: LoopState, x0: PerType) -> LoopState:
        return loop.update(inputs, temperature, state, x0, evaluation)

    return StoredProgram(update, shared=2, options=(sampler, config, num_steps), light=True)


@functools.lru_cache(maxsize=8)
def prepare_program(sampler: Sampler, config: DenoiserConfig, num_steps: int, guided: bool) -> StoredProgram:
    """(parameters; loop inputs, crop, domain, attributes, negative attributes, kinds, features, negative
    features) -> the denoiser's inputs in all steps."""
    times = sampling_loop(sampler, config, num_steps).schedule.levels.time

    def prepare(
        params: Params,
        inputs: LoopInputs,
        crop: Array,
        domain: Array,
        attributes: Array | None,
        negative_attributes: Array | None,
        kinds: PerType | None,
        features,
        negative,
    ) -> DenoiserInputs:
        return prepare_denoiser_inputs(
            denoiser(config),
            config,
            params,
            config.domains * crop + domain,
            inputs.masks,
            times=times,
            guided=guided,
            known=inputs.known,
            attributes=attributes,
            negative_attributes=negative_attributes,
            kinds=kinds,
            features=features,
            negative=negative,
        )

    return StoredProgram(prepare, shared=1, options=(sampler, config, num_steps, guided), light=True)


@functools.lru_cache(maxsize=8)
def advance_program(
    sampler: Sampler, config: DenoiserConfig, num_steps: int, guidance: Guidance | None
) -> StoredProgram:
    """(parameters, guidance scales, temperature, first and last evaluation; loop inputs, the denoiser's inputs, state,
    x0 estimates) -> state and x0 estimates at the last evaluation; see ``SamplingLoop.advance``."""
    loop = sampling_loop(sampler, config, num_steps)

    def advance(
        params: Params,
        scales: tuple[Array, Array | None],
        temperature: PerType,
        first: Array,
        last: Array,
        inputs: LoopInputs,
        denoiser_inputs: DenoiserInputs,
        state: LoopState,
        x0: PerType,
    ) -> tuple[LoopState, PerType]:
        denoise = denoise_fn(
            denoiser(config),
            params,
            denoiser_inputs,
            times=loop.schedule.levels.time,
            guidance=guidance,
            guidance_scale=scales[0],
            image_scale=scales[1],
        )
        return loop.advance(inputs, temperature, denoise, state, x0, first, last)

    return StoredProgram(advance, shared=5, options=(sampler, config, num_steps, guidance))


@functools.lru_cache(maxsize=8)
def descend_program(config: DenoiserConfig, options: EnergyGuidance) -> StoredProgram:
    """(the position heads' parameters; descent, scenes that its lookahead decodes to, loop inputs) -> the descent after
    a gradient step."""

    def energy_step(params: Params, descent: Descent, scenes: Scene, inputs: LoopInputs) -> Descent:
        heads = position_heads(config.agent_latent, config.lane_latent)
        generated = generated_mask(inputs.masks, inputs.known)
        return descend(descent, scenes, functools.partial(heads.apply, params), generated, options)

    functions = (ENERGIES[name] for name, _ in options.energies)
    return StoredProgram(energy_step, shared=1, options=(config, options, *functions), light=True)


def _exact(config: AutoencoderConfig) -> AutoencoderConfig:
    """The network in float32, whatever it was trained in.

    With bfloat16 points of a lane are up to a decimeter off: of 44 raw scenes of people's prompts 14 had a kinked lane,
    with float32 2.
    """
    return dataclasses.replace(config, compute="float32")


def decode_latents(
    config: AutoencoderConfig,
    params: Params,
    codec: SceneCodec,
    latents: PerType,
    masks: PerType,
    crop,
    domain,
    known: Scene | None = None,
) -> Scene:
    """Latents [B, tokens, latent] -> scenes in meters [B]; ``params`` are the decoder's.

    With ``config.shared_endpoints`` the known lanes of ``known``, padded alike, do not move; others end where they do.
    """
    decoded = decoder(config).apply(params, latents, masks)
    lane_types = jnp.zeros(masks.lanes.shape, jnp.int32)
    if codec.num_lane_types:
        lane_types = decoded.lane_type_logits.argmax(-1)
    scenes = codec.denormalize(
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
    if not config.shared_endpoints:
        return scenes
    if known is None:
        return share_endpoints(scenes)
    fixed = jnp.asarray(known.lane_mask)
    lanes = jnp.where(fixed[..., None, None], known.lanes, scenes.lanes)
    return share_endpoints(scenes.replace(lanes=lanes), fixed=fixed)
