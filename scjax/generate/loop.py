"""From the requests of a batch to scenes, through the compiled programs."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from scjax.diffusion.energy_guidance import Descent, EnergyGuidance, gradient_steps_per_level
from scjax.diffusion.guidance import Guidance
from scjax.diffusion.samplers import Sampler
from scjax.diffusion.samplers.loop import LoopInputs, SamplingLoop
from scjax.generate import compiled
from scjax.generate.batching import Bucket
from scjax.generate.encode import NetworkInputs, network_inputs
from scjax.generate.model import Model
from scjax.generate.requests import Request
from scjax.language.attributes.vector import request_vector
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.kinds import NO_KIND
from scjax.scene import Scene, empty, pad, stack
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class SamplingSettings:
    """Options of a call that hold for all of its scenes.

    Attributes:
      guidance: interval and rescaling; None is plain sampling.
      guidance_scales: scale of guidance, and that of the picture or None. They are arguments of the programs: every
        other scale is the same program.
      energy_guidance: None leaves the estimates as they are.
    """

    sampler: Sampler
    num_steps: int
    guidance: Guidance | None
    guidance_scales: tuple[float, float | None]
    temperature: PerType
    energy_guidance: EnergyGuidance | None


@dataclasses.dataclass(frozen=True)
class Batch:
    """Requests of one padded size as arrays.

    Attributes:
      masks: True at valid tokens [B, tokens] per type.
      known_scenes: known elements in token order, padded; None: none.
      attributes, negative_attributes: features of the requests and of what guidance leads away from [B, features];
        None: the network reads none.
      kinds: of the tokens [B, tokens] per type, -1 where none is given; None: the network reads none.
      features: of the conditions and of the negative prompts (``network_inputs``).
    """

    keys: Array
    masks: PerType
    crop: Int[np.ndarray, " b"]
    domain: Int[np.ndarray, " b"]
    known_scenes: Scene | None
    attributes: Float[np.ndarray, "b features"] | None
    negative_attributes: Float[np.ndarray, "b features"] | None
    kinds: PerType | None
    features: NetworkInputs

    @classmethod
    def of_requests(cls, requests: Sequence[Request], bucket: Bucket, config: DenoiserConfig) -> Batch:
        """The requests, padded to a bucket, for a network of these options."""
        specs = [request.spec for request in requests]
        crop = np.array([spec.crop for spec in specs], np.int32)
        known = None
        if any(spec.known is not None for spec in specs):
            nothing = empty(*bucket)
            parts = [nothing if spec.known is None else pad(spec.known.tokens, *bucket) for spec in specs]
            known = stack([part.replace(crop=np.asarray(one)) for part, one in zip(parts, crop, strict=True)])
        return cls(
            keys=jnp.stack([request.key for request in requests]),
            masks=PerType(
                agents=_valid(bucket[0], [request.num_agents for request in requests]),
                lanes=_valid(bucket[1], [request.num_lanes for request in requests]),
            ),
            crop=crop,
            domain=np.array([request.domain for request in requests], np.int32),
            known_scenes=known,
            attributes=_features([spec.attributes for spec in specs], config),
            negative_attributes=_features([spec.negative_attributes for spec in specs], config),
            kinds=_padded_kinds(requests, bucket) if config.agent_kinds else None,
            features=network_inputs([spec.streams for spec in specs], config.condition),
        )


def sample_batch(
    model: Model,
    settings: SamplingSettings,
    batch: Batch,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> Scene:
    """Scenes in meters [B], as NumPy arrays.

    Args:
      progress: is called after each program of the loop with the number of parts so far and of all.
    """
    config, coder = model.denoiser.config, (model.codec, model.autoencoder.config)
    params = model.denoiser.placed_params(len(batch.crop))
    coder_params, statistics = model.autoencoder.placed_params(len(batch.crop)), (model.latents.mean, model.latents.std)
    options = settings.sampler, config, settings.num_steps
    loop = compiled.sampling_loop(*options)

    known = known_latents = None
    if batch.known_scenes is not None:
        known, known_latents = compiled.encode_program(*coder)(coder_params, *statistics, batch.known_scenes)
    inputs = LoopInputs(keys=batch.keys, masks=batch.masks, known=known, known_latents=known_latents)
    prepare = compiled.prepare_program(*options, settings.guidance is not None)
    given = batch.attributes, batch.negative_attributes, batch.kinds
    denoiser_inputs = prepare(params, inputs, batch.crop, batch.domain, *given, *batch.features)
    advance = compiled.advance_program(*options, settings.guidance)

    # Other decoders do not read known scenes, and would be compiled once more for them.
    known_scenes = batch.known_scenes if model.autoencoder.config.shared_endpoints else None

    def decode(latents: PerType) -> Scene:
        program = compiled.decode_program(*coder)
        scenes = batch.crop, batch.domain, known_scenes
        return program(coder_params["decoder"], *statistics, latents, batch.masks, *scenes)

    state = compiled.start_program(*options)(settings.temperature, inputs)
    x0, first = state.x, len(loop.levels) - 1
    scales = jax.tree.map(np.float32, settings.guidance_scales)
    gradient_steps = _gradient_steps(loop, settings.energy_guidance)
    stops = sorted({0, *gradient_steps}, reverse=True)
    for part, last in enumerate(stops):
        progress(part, len(stops) + 1)
        bounds = np.int32(first), np.int32(last)
        state, x0 = advance(params, scales, settings.temperature, *bounds, inputs, denoiser_inputs, state, x0)
        if settings.energy_guidance is not None and last in gradient_steps:
            program = compiled.descend_program(config, settings.energy_guidance)
            x0 = _descend(
                functools.partial(program, params["position_heads"]), decode, x0, inputs, gradient_steps[last]
            )
        first = last - 1
    progress(len(stops), len(stops) + 1)
    state = compiled.update_program(*options)(settings.temperature, np.int32(0), inputs, state, x0)
    scenes = jax.device_get(decode(state.x))
    progress(len(stops) + 1, len(stops) + 1)
    return scenes


def _gradient_steps(loop: SamplingLoop, options: EnergyGuidance | None) -> dict[int, int]:
    """Evaluation -> number of gradient steps, where there are any."""
    if options is None:
        return {}
    steps = gradient_steps_per_level(options, loop.schedule.levels)[loop.levels]
    return {int(evaluation): int(steps[evaluation]) for evaluation in np.flatnonzero(steps)}


def _descend(
    energy_step: Callable[[Descent, Scene, LoopInputs], Descent],
    decode: Callable[[PerType], Scene],
    x0: PerType,
    inputs: LoopInputs,
    steps: int,
) -> PerType:
    """The x0 estimate after gradient steps; the links are those of the first decoded scene."""
    links = None
    at_rest = jax.tree.map(lambda x: jax.device_put(np.zeros(x.shape, x.dtype), x.sharding), x0)  # compiles nothing
    descent = Descent(latents=x0, velocity=at_rest, lookahead=x0)
    for _ in range(steps):
        scenes = decode(descent.lookahead)
        links = scenes.links if links is None else links
        descent = energy_step(descent, scenes.replace(links=links), inputs)
    return descent.latents


def _features(requests: Sequence[Mapping[str, Any]], config: DenoiserConfig) -> Float[np.ndarray, "b a"] | None:
    names = config.attributes
    return np.stack([request_vector(request, names) for request in requests]) if names else None


def _padded_kinds(requests: Sequence[Request], bucket: Bucket) -> PerType:
    kinds = [np.full((len(requests), slots), NO_KIND, np.int32) for slots in bucket]
    for row, request in enumerate(requests):
        if request.kinds is not None:
            kinds[0][row, : len(request.kinds.agents)] = request.kinds.agents
            kinds[1][row, : len(request.kinds.lanes)] = request.kinds.lanes
    return PerType(agents=kinds[0], lanes=kinds[1])


def _valid(slots: int, counts: Sequence[int]) -> Bool[np.ndarray, "b slots"]:
    return np.arange(slots)[None] < np.asarray(counts)[:, None]
