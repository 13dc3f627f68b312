"""``scjax.sample``: condition -> scenes in metres. One compiled program a bucket of padded shapes."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scjax.data.token_order import sort_tokens
from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.diffusion.guidance import Guidance
from scjax.diffusion.samplers import DEFAULT_STEPS, Sampler, resolve_sampler
from scjax.generate.compiled import reconstruction_program, sampling_program
from scjax.generate.conditions import Condition
from scjax.generate.encode import check_readable, features_of, text_features
from scjax.generate.model import Model, load_model
from scjax.generate.prompts import encode_prompts
from scjax.models.counts.predictor import CountPredictorConfig, count_predictor
from scjax.models.counts.prior import draw_counts
from scjax.models.denoiser.config import DenoiserConfig, TextCondition
from scjax.nn.sharding import replicated
from scjax.scene import Crop, Scene, empty, pad, permute, stack, unpadded
from scjax.scene.per_type import PerType

BUCKETS = ((16, 28), (32, 48), (61, 100))  # (agent, lane) slots; each is a program to compile
GROUP = 4  # scenes a compiled call, when there is more than one; 8 would be a tenth faster a scene

Tables = dict[tuple[int, int | None, Crop], np.ndarray | None]


def sample(
    key: Array,
    cond: Condition | None = None,
    *,
    model: Model | None = None,
    n: int = 1,
    sampler: str | Sampler | None = None,
    steps: int | None = None,
    guidance: float | Guidance | None = None,
    temperature: float | PerType | None = None,
    energy_guidance: EnergyGuidance | bool | None = None,
) -> Scene:
    """``n`` scenes under one condition, [n, ...] in metres, padded to their largest size.

    Scene i depends on ``fold_in(key, i)`` only, not on ``n``.

    Args:
      key: typed key, ``jax.random.key(0)``.
      cond: what to hold fixed; None draws everything.
      model: from ``scjax.load``; None: the one that ships.
      sampler: "ddpm" (the default of most models), "ddim", "dpm++" or, for a rectified flow, "euler", "heun" (its
        default), "dpm++"; or one with options, as ``scjax.diffusion.samplers.DDIM(eta=0.5)``.
      steps: sampling steps, 2..100; by default those of ``scjax.diffusion.samplers.DEFAULT_STEPS``.
      guidance: w in u + w (c - u), of the estimates with and without condition; 1, the default of unconditional models,
        is plain sampling. ``Guidance`` also takes an interval of times and rescaling.
      temperature: scale of the noise, above 0: one for both kinds, or ``scjax.scene.per_type.PerType(agents=, lanes=)``; by
        default the model's. Lower is tidier and less varied.
      energy_guidance: True leads what is sampled to closed joints, boxes that do not overlap and vehicles on lanes
        (``scjax.diffusion.energy_guidance``), False does not; by default as the model has it.

    Raises:
      ValueError: no model, a model without denoiser, a condition that the model can't meet, a sampler that does not fit
        what its network estimates, or a temperature that is not positive.
    """
    if n < 1:
        raise ValueError(f"n must be at least 1, not {n}")
    conditions = [cond or Condition()] * n
    made = sample_many(
        key, conditions, model=model, sampler=sampler, steps=steps, guidance=guidance, temperature=temperature,
        energy_guidance=energy_guidance,
    )  # fmt: skip
    return stack(made)


def sample_many(
    key: Array,
    conditions: Sequence[Condition],
    *,
    model: Model | None = None,
    sampler: str | Sampler | None = None,
    steps: int | None = None,
    guidance: float | Guidance | None = None,
    temperature: float | PerType | None = None,
    energy_guidance: EnergyGuidance | bool | None = None,
) -> list[Scene]:
    """One unpadded NumPy scene per condition; arguments and errors as in ``sample``."""
    model = load_model() if model is None else model
    config = model.denoiser.config
    conditions = encode_prompts(conditions, model)
    check_readable(conditions, config.condition)
    sampler = resolve_sampler(sampler, config.prediction)
    if guidance is None:
        guidance = DEFAULT_GUIDANCE_SCALE if config.condition is not None else 1.0
    if not isinstance(guidance, Guidance):
        guidance = Guidance(float(guidance))
    temperature = _temperature(model.temperature if temperature is None else temperature)
    if energy_guidance is None or energy_guidance is True:
        energy_guidance = model.energy_guidance or (EnergyGuidance() if energy_guidance else None)
    tables: Tables = {}
    requests = [_request(jax.random.fold_in(key, i), cond, model, tables) for i, cond in enumerate(conditions)]
    # The weight is an argument of the program: every other weight is the same program.
    options = None if guidance.scale == 1 else dataclasses.replace(guidance, scale=DEFAULT_GUIDANCE_SCALE)
    steps = DEFAULT_STEPS[config.prediction][sampler.name] if steps is None else steps
    program = sampling_program(
        model.codec, model.autoencoder.config, config, sampler, steps, options, energy_guidance or None
    )
    groups: dict[tuple[int, int], list[int]] = {}
    for i, request in enumerate(requests):
        groups.setdefault(bucket_of(*request.counts), []).append(i)
    results: dict[int, Scene] = {}
    size = 1 if len(requests) == 1 else GROUP
    weights = replicated(
        (model.autoencoder.params, model.denoiser.params), size
    )  # once, not in every call of a program
    for bucket, members in groups.items():
        for start in range(0, len(members), size):
            part = members[start : start + size]
            chosen = [requests[i] for i in part] + [requests[part[0]]] * (size - len(part))
            batch = program(
                *weights, model.latents.mean, model.latents.std, jnp.float32(guidance.scale), temperature,
                *_collate(chosen, bucket, config),
            ).to_numpy()  # fmt: skip
            for row, i in enumerate(part):
                results[i] = requests[i].finish(batch[row])
    return [results[i] for i in range(len(requests))]


def with_counts(key: Array, conditions: Sequence[Condition], *, model: Model | None = None) -> list[Condition]:
    """Conditions with the numbers of lanes and agents that they leave open, drawn as ``sample_many`` draws them.

    Raises:
      ValueError: as ``sample``, of the conditions.
    """
    model, tables = load_model() if model is None else model, {}
    requests = [_request(jax.random.fold_in(key, i), cond, model, tables) for i, cond in enumerate(conditions)]
    return [
        dataclasses.replace(cond, num_agents=request.counts[0], num_lanes=request.counts[1])
        for cond, request in zip(conditions, requests, strict=True)
    ]


def reconstruct(model: Model, scenes: Sequence[Scene]) -> list[Scene]:
    """Each scene encoded and decoded again from its posterior mean, unpadded, tokens in the given order.

    The scenes must be of the model's types (``model.codec.select``), so that twins match by index.

    Raises:
      ValueError: the model has no autoencoder, or a scene has more elements than the largest bucket.
    """
    program = reconstruction_program(model.codec, model.autoencoder.config)
    results: dict[int, Scene] = {}
    chosen = [scene.to_numpy() for scene in scenes]
    groups: dict[tuple[int, int], list[int]] = {}
    for i, scene in enumerate(chosen):
        groups.setdefault(bucket_of(scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]), []).append(i)
    for bucket, members in groups.items():
        for start in range(0, len(members), GROUP):
            part = members[start : start + GROUP]
            batch = stack([chosen[i] for i in part + [part[0]] * (GROUP - len(part))], bucket)
            decoded = program(model.autoencoder.params, batch).to_numpy()
            results.update({i: unpadded(decoded[row]) for row, i in enumerate(part)})
    return [results[i] for i in range(len(chosen))]


class _Request:
    """One scene to make: its key, totals, label and known elements (in token order)."""

    def __init__(self, key: Array, counts: tuple[int, int], domain: int, cond: Condition, known: Scene | None):
        self.key, self.counts, self.domain, self.cond = key, counts, domain, cond
        self.original = known
        self.known, self.agent_order, self.lane_order = None, np.arange(0), np.arange(0)
        if known is not None:
            self.known, self.agent_order, self.lane_order = sort_tokens(known)

    def finish(self, scene: Scene) -> Scene:
        """Unpadded, and every known element exactly as it was given, in its given place."""
        scene = unpadded(scene)
        if self.original is None:
            return scene
        agents, lanes = (
            np.concatenate([np.argsort(order), np.arange(len(order), total)])
            for order, total in zip((self.agent_order, self.lane_order), self.counts, strict=True)
        )
        scene, known = permute(scene, agents, lanes), self.original
        num_agents, num_lanes = len(self.agent_order), len(self.lane_order)
        fields = scene.to_dict()
        for name in ("agents", "agent_types", "agent_known"):
            fields[name] = np.concatenate([getattr(known, name), fields[name][num_agents:]])
        for name in ("lanes", "lane_known", "signals"):
            fields[name] = np.concatenate([getattr(known, name), fields[name][num_lanes:]])
        links = fields["links"].copy()
        links[:num_lanes, :num_lanes] = known.links
        return scene.replace(**{**fields, "links": links})


def _request(key: Array, cond: Condition, model: Model, tables: Tables) -> _Request:
    """Draws what ``cond`` leaves open (host side, from the scene's own key)."""
    config = model.denoiser.config
    known = None
    if cond.known is not None:
        known = model.codec.select(unpadded(cond.known.to_numpy()))
    least = (0, 0) if known is None else (known.agent_mask.shape[-1], known.lane_mask.shape[-1])
    for name, value, low, most in (
        ("num_agents", cond.num_agents, least[0], config.max_agents),
        ("num_lanes", cond.num_lanes, least[1], config.max_lanes),
    ):
        if value is not None and not low <= value <= most:
            raise ValueError(
                f"Condition.{name} is {value}, but must lie in {max(low, 1)}..{most} "
                f"(known elements .. the model's maximum)"
            )
    domain = cond.domain
    if isinstance(domain, str):
        if domain not in model.domains:
            raise ValueError(f"Condition.domain {domain!r} is unknown: this model has {', '.join(model.domains)}")
        domain = model.domains.index(domain)
    if domain is not None and not 0 <= domain < len(model.domains):
        raise ValueError(f"Condition.domain {domain} is outside 0..{len(model.domains) - 1} ({model.domains})")
    seed = np.asarray(jax.random.key_data(jax.random.fold_in(key, 0xC0)))
    rng = np.random.default_rng(seed.astype(np.uint32))
    told = id(cond.tokens), domain, cond.crop
    if told not in tables:  # many scenes of one prompt are common
        tables[told] = _count_table(cond, domain, model)
    domain, lanes, agents = draw_counts(
        rng, tables[told], cond.crop, domain=domain, num_lanes=cond.num_lanes,
        num_agents=cond.num_agents, least_lanes=least[1], least_agents=least[0],
    )  # fmt: skip
    return _Request(key, (agents, lanes), domain, cond, known)


def _count_table(cond: Condition, domain: int | None, model: Model) -> np.ndarray | None:
    """Probabilities of (domain, layout, N_l, N_o): of the prompt where the model has learnt that, else of the data."""
    if cond.tokens is None or "count_predictor" not in model.components or cond.crop == Crop.FORWARD:
        return model.counts
    config = model.count_predictor.config
    text = TextCondition(config.text_width)
    features = text_features([(cond.tokens, cond.token_mask)], len(cond.tokens), text)
    label = jnp.array([config.domains if domain is None else domain])
    likely = np.asarray(_counter_program(config)(model.count_predictor.params, features, label)[0], np.float64)
    told = np.exp(config.sharpness * (likely - likely.max()))
    table = np.broadcast_to(told / told.sum(), (1, len(Crop), *told.shape))
    shares = np.ones(config.domains) if model.counts is None else model.counts.sum((1, 2, 3))
    return (shares / shares.sum())[:, None, None, None] * table


@functools.lru_cache(maxsize=4)
def _counter_program(config: CountPredictorConfig) -> Callable[..., Array]:
    return jax.jit(count_predictor(config).apply)


def _collate(requests: list[_Request], bucket: tuple[int, int], config: DenoiserConfig):
    """Requests -> (keys, masks, layout, domain, known scenes, features, those of negative prompts), batched."""
    agent_slots, lane_slots = bucket
    masks = PerType(
        agents=np.stack([np.arange(agent_slots) < request.counts[0] for request in requests]),
        lanes=np.stack([np.arange(lane_slots) < request.counts[1] for request in requests]),
    )
    known = None
    if any(request.known is not None for request in requests):
        none = empty(agent_slots, lane_slots)
        parts = [none if r.known is None else pad(r.known, agent_slots, lane_slots) for r in requests]
        crops = [np.asarray(request.cond.crop, np.int32) for request in requests]
        known = stack([part.replace(crop=crop) for part, crop in zip(parts, crops, strict=True)])
    features, negative = features_of([request.cond for request in requests], config.condition)
    crop = np.array([request.cond.crop for request in requests], np.int32)
    domain = np.array([request.domain for request in requests], np.int32)
    return jnp.stack([request.key for request in requests]), masks, crop, domain, known, features, negative


def bucket_of(agents: int, lanes: int) -> tuple[int, int]:
    """The least padded shape that holds so many; few shapes mean few compilations."""
    for bucket in BUCKETS:
        if agents <= bucket[0] and lanes <= bucket[1]:
            return bucket
    raise ValueError(f"{agents} agents and {lanes} lanes are more than the {BUCKETS[-1]} that a scene may have")


def _temperature(value: float | PerType) -> PerType:
    both = value if isinstance(value, PerType) else PerType(agents=value, lanes=value)
    if not all(0 < one < math.inf for one in (both.agents, both.lanes)):
        raise ValueError(f"temperature must be positive for agents and lanes, not {value}: 1 is that of the training")
    return jax.tree.map(jnp.float32, both)
