"""``scjax.sample``: conditions -> scenes in meters.

The stages, in order, each a module of this package:

1. ``scene_spec``: what the conditions hold fixed, in the terms of the model. ``readings`` makes attributes of prompts,
   for models that read these, and ``encode`` tokens of texts and pictures. Later stages know specs alone.
2. ``requests``: a scene's own key draws what is open: domain, numbers of lanes and agents, and its outline. That says
   what each lane and agent is, without coordinates. The model holds outlines of 8,000 scenes of its training; one that
   shows the request is drawn.
3. ``batching``, ``loop``, ``compiled``: latents by the sampler (``diffusion.samplers``), decoded, in batches of few
   padded sizes.
4. ``Request.finish``: known elements exactly as they were given, and what a picture shows.
5. ``scjax.repair`` and ``best_of``, if they are chosen.

Stages 1, 2, 4 and 5 run in NumPy on the host; stage 3 is jitted. So ``scjax.sample`` cannot be called under ``jax.jit``
or ``jax.vmap``: give it several conditions instead.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeGuard, overload

import jax
import jax.numpy as jnp
from jaxtyping import Array

from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.diffusion.guidance import MAX_SCALE, Guidance
from scjax.diffusion.samplers import DEFAULT_STEPS, Sampler, resolve_sampler
from scjax.generate.arguments import (
    MAX_SCENES,
    MAX_STEPS,
    MAX_TEMPERATURE,
    as_conditions,
    as_model,
    check_finite,
    sampling_key,
)
from scjax.generate.batching import GROUP, Bucket, in_batches, least_size
from scjax.generate.best_of import best_index
from scjax.generate.conditions import Condition
from scjax.generate.counts import CountTables
from scjax.generate.fit_request import best_fitted
from scjax.generate.loop import Batch, SamplingSettings, sample_batch
from scjax.generate.model import Model
from scjax.generate.requests import Request, draw_candidates
from scjax.generate.scene_spec import SceneSpec, specify_scenes
from scjax.models.denoiser.config import ImageCondition
from scjax.scene import Scene, stack
from scjax.scene.arguments import finite_number, truth_value, whole_number
from scjax.scene.per_type import PerType
from scjax.scene.repair import repair as repair_scene


@overload
def sample_scenes(
    key: Array | int,
    condition: Condition | str | None = None,
    *,
    model: Model | str | Path | None = None,
    num_scenes: int = 1,
    num_steps: int | None = None,
    guidance: float | Guidance | None = None,
    sampler: str | Sampler | None = None,
    best_of: int = 1,
    repair: bool = False,
    temperature: float | PerType | None = None,
    energy_guidance: EnergyGuidance | bool | None = None,
    padded_size: tuple[int, int] | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Scene: ...


@overload
def sample_scenes(
    key: Array | int,
    condition: Sequence[Condition | str] | Sequence[SceneSpec],
    *,
    model: Model | str | Path | None = None,
    num_scenes: int = 1,
    num_steps: int | None = None,
    guidance: float | Guidance | None = None,
    sampler: str | Sampler | None = None,
    best_of: int = 1,
    repair: bool = False,
    temperature: float | PerType | None = None,
    energy_guidance: EnergyGuidance | bool | None = None,
    padded_size: tuple[int, int] | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> list[Scene]: ...


def sample_scenes(
    key: Array | int,
    condition: Condition | str | Sequence[Condition | str] | Sequence[SceneSpec] | None = None,
    *,
    model: Model | str | Path | None = None,
    num_scenes: int = 1,
    num_steps: int | None = None,
    guidance: float | Guidance | None = None,
    sampler: str | Sampler | None = None,
    best_of: int = 1,
    repair: bool = False,
    temperature: float | PerType | None = None,
    energy_guidance: EnergyGuidance | bool | None = None,
    padded_size: tuple[int, int] | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Scene | list[Scene]:
    """Samples ``num_scenes`` scenes for one condition, or for each of several conditions.

    Scene i depends on ``fold_in(key, i)`` only, not on how many scenes are sampled with it. With several conditions,
    scene j of condition c is scene number ``c * num_scenes + j``. A single scene is sampled by another program than
    several are, and so it is on another processor. Then scenes of one key differ in their last bits.

    Args:
      key: typed key, ``jax.random.key(0)``, or the number of one.
      condition: what to hold fixed; a text is a condition with that prompt; None draws everything. Instead of
        conditions it may be their specs (``specify_scenes``, for this model), whose prompts are not read again.
      model: from ``scjax.load``, or a model folder, which is read at every call; None: the model that ships with the
        package.
      num_scenes: scenes for each condition.
      num_steps: sampling steps, 2..100; by default the model's, or those of the sampler that is named here
        (``scjax.samplers.DEFAULT_STEPS``).
      guidance: w in u + w (c - u), of the estimates c with and u without the condition; by default the model's. 1 is
        plain sampling. ``scjax.Guidance`` also takes an interval of times, rescaling and a scale of the picture.
      sampler: "ddpm" (the default of most models), "ddim", "dpm++" or, for a rectified flow, "euler", "heun" (its
        default), "dpm++"; or one with options, such as ``scjax.samplers.DDIM(eta=0.5)``.
      best_of: number of candidates for each scene. The one with the lowest ``score_scene`` is returned; that counts
        faults and what is missing of the request. The first candidate is the scene that ``best_of=1`` returns.
      repair: smooth lanes, close lane connections and separate boxes afterwards (``scjax.repair``), then fit agents
        and ground to the request (``generate.fit_request``); known elements stay as they are.
      temperature: scale of the noise, above 0: one number, or ``scjax.PerType(agents=, lanes=)``; by default the
        model's. Lower gives cleaner and less varied scenes.
      energy_guidance: True, False or options: gradient steps towards closed lane connections, boxes that do not overlap
        and vehicles on lanes (``scjax.EnergyGuidance``); by default as the model has it.
      padded_size: (agents, lanes) that every scene is padded to at least, so that scenes of several sizes share
        compiled programs. By default each scene is padded to the smallest of a few sizes that holds it. That runs
        fastest, but every size compiles once.
      progress: is called while scenes are sampled, with how many parts of the work are done, and how many there are.

    Returns:
      For one condition a batch [num_scenes] of NumPy arrays in meters, padded to its largest scene. For a sequence of
      conditions a list of single scenes without padding, condition by condition.

    Raises:
      ValueError: an option out of range, a model without denoiser or autoencoder, a condition that the model cannot
        read or meet, or a sampler that does not fit what the network estimates.
    """
    key = sampling_key(key)
    num_scenes = whole_number(num_scenes, "num_scenes", 1, MAX_SCENES)
    best_of = whole_number(best_of, "best_of", 1, MAX_SCENES)
    repair = truth_value(repair, "repair")
    least = least_size(padded_size)
    is_single = condition is None or isinstance(condition, Condition | str)
    condition = condition if _are_specs(condition) else as_conditions(condition, num_scenes)
    model = as_model(model)
    settings = sampling_settings(model, num_steps, guidance, sampler, temperature, energy_guidance)

    specs = specify_scenes(condition, model)
    tables = CountTables(model)
    keys = (jax.random.fold_in(key, i) for i in range(len(specs) * num_scenes))
    groups = [draw_candidates(next(keys), spec, model, tables, best_of) for spec in specs for _ in range(num_scenes)]
    candidates = [candidate for group in groups for candidate in group]
    scenes = sample_requests(candidates, model, settings, least, progress)
    check_finite(scenes)
    if repair:
        scenes = [_repair_generated(scene, request) for scene, request in zip(scenes, candidates, strict=True)]
    scenes = [
        _best_candidate(scenes[start : start + best_of], group, repair)
        for start, group in zip(range(0, len(scenes), best_of), groups, strict=True)
    ]
    return stack(scenes) if is_single else scenes


def _are_specs(value: Any) -> TypeGuard[Sequence[SceneSpec]]:
    return isinstance(value, Sequence) and len(value) > 0 and all(isinstance(one, SceneSpec) for one in value)


def sampling_settings(
    model: Model,
    num_steps: int | None,
    guidance: float | Guidance | None,
    sampler: str | Sampler | None,
    temperature: float | PerType | None,
    energy_guidance: EnergyGuidance | bool | None,
) -> SamplingSettings:
    """Options of ``sample_scenes``, those that are None as the model has them.

    Raises:
      ValueError: an option is out of range or does not fit the model.
    """
    config = model.denoiser.config
    num_steps = model.num_steps if num_steps is None and sampler is None else num_steps
    sampler = resolve_sampler(sampler, config.prediction)
    num_steps = DEFAULT_STEPS[config.prediction][sampler.name] if num_steps is None else num_steps
    num_steps = whole_number(num_steps, "num_steps", 2, MAX_STEPS)
    guidance = model.guidance if guidance is None else guidance
    if guidance is None:
        guidance = DEFAULT_GUIDANCE_SCALE if config.is_conditional else 1.0
    if not isinstance(guidance, Guidance):
        guidance = Guidance(finite_number(guidance, "guidance", -MAX_SCALE, MAX_SCALE))
    if energy_guidance is not None and not isinstance(energy_guidance, EnergyGuidance):
        energy_guidance = truth_value(energy_guidance, "energy_guidance (or scjax.EnergyGuidance)")
    if guidance.image_scale is not None and not isinstance(config.condition, ImageCondition):
        raise ValueError("guidance.image_scale is given, but this model reads no pictures: leave it out")
    scales = guidance.scale, guidance.image_scale  # numbers of a call; options compile, so theirs are always the same
    image_scale = None if guidance.image_scale is None else DEFAULT_GUIDANCE_SCALE
    options = dataclasses.replace(guidance, scale=DEFAULT_GUIDANCE_SCALE, image_scale=image_scale)
    if scales[0] == 1 and scales[1] in (None, 1):
        scales, options = (1.0, None), None
    if energy_guidance is None or energy_guidance is True:
        energy_guidance = model.energy_guidance or (EnergyGuidance() if energy_guidance else None)
    if energy_guidance and not config.relative_geometry:
        raise ValueError(
            "energy_guidance needs a denoiser that estimates positions, and this model's does not: leave it out, or "
            "train the denoiser with relative_geometry=True"
        )
    return SamplingSettings(
        sampler=sampler,
        num_steps=num_steps,
        guidance=options,
        guidance_scales=scales,
        temperature=_temperature(model.temperature if temperature is None else temperature),
        energy_guidance=energy_guidance or None,
    )


def _temperature(value: float | PerType) -> PerType:
    both = value if isinstance(value, PerType) else PerType(agents=value, lanes=value)
    agents, lanes = (finite_number(one, "temperature", 0.0, MAX_TEMPERATURE) for one in (both.agents, both.lanes))
    if not (agents > 0 and lanes > 0):
        raise ValueError(f"temperature must be positive for agents and lanes, not {value}: 1 is that of the training")
    return PerType(agents=jnp.float32(agents), lanes=jnp.float32(lanes))


def sample_requests(
    requests: Sequence[Request],
    model: Model,
    settings: SamplingSettings,
    least: Bucket = (0, 0),
    progress: Callable[[int, int], object] | None = None,
) -> list[Scene]:
    """The scenes of the requests, unpadded, in their order; sampled in batches of equal shapes.

    Args:
      progress: as in ``sample_scenes``.
    """
    scenes: dict[int, Scene] = {}
    sizes = [(request.num_agents, request.num_lanes) for request in requests]
    batches = list(in_batches(sizes, 1 if len(requests) == 1 else GROUP, least))
    for number, (bucket, indices, rows) in enumerate(batches):
        batch = Batch.of_requests([requests[i] for i in rows], bucket, model.denoiser.config)
        sampled = sample_batch(model, settings, batch, part_of(progress, number, len(batches)))
        scenes.update({index: requests[index].finish(sampled[row]) for row, index in enumerate(indices)})
    return [scenes[index] for index in range(len(requests))]


def part_of(progress: Callable[[int, int], object] | None, number: int, numbers: int) -> Callable[[int, int], object]:
    """What part ``number`` of ``numbers`` equal ones calls, so that ``progress`` is of all of them."""

    def of_all(done: int, total: int) -> None:
        if progress is not None:
            progress(number * total + done, numbers * total)

    return of_all


def _best_candidate(scenes: Sequence[Scene], requests: Sequence[Request], repair: bool) -> Scene:
    """The best of the candidates for one scene; with ``repair`` each is fitted to its request before."""
    if repair:
        return best_fitted(scenes, requests)
    return scenes[best_index(scenes, requests[0].spec.attributes)] if len(scenes) > 1 else scenes[0]


def _repair_generated(scene: Scene, request: Request) -> Scene:
    known_agents, known_lanes = request.spec.known_counts
    return repair_scene(scene, known_agents=known_agents, known_lanes=known_lanes)
