"""Stage 2: the latent denoiser, trained on a frozen autoencoder that encodes every batch anew."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from scjax.camera.raycast import CLASSES, GRID
from scjax.data.build import load_manifest
from scjax.data.caption_features import TextStore
from scjax.data.loader import Example, batch_of, captioned, pictured, training_batches, validation_scenes
from scjax.diffusion.energies.collision import collision_energy, collision_weight
from scjax.diffusion.loss import LatentBatch, training_loss
from scjax.diffusion.relation_loss import connection_error, lateral_offset_error, relation_weight
from scjax.diffusion.schedule import cosine_schedule
from scjax.diffusion.timestep_sampling import TimestepSampling
from scjax.generate.compiled import decode
from scjax.generate.conditions import Condition
from scjax.generate.model import Model, load_model
from scjax.generate.sample import sample_many
from scjax.models.autoencoder.model import autoencoder
from scjax.models.autoencoder.outputs import reparameterize
from scjax.models.codec import SceneCodec
from scjax.models.counts.prior import count_table
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ConditionFeatures, ImageFeatures, TextFeatures
from scjax.models.denoiser.model import denoiser
from scjax.nn.cross_attention import CrossAttentionOptions, from_name
from scjax.nn.functional import Params, flatten, unflatten
from scjax.scene import Crop, Scene
from scjax.scene.per_type import PerType
from scjax.train.fit_position_head import fit_anchors
from scjax.train.flat_params import FlatParams
from scjax.train.reporter import Reporter
from scjax.train.step import Stage, TrainState, initial, make_optimizer, pipeline_config, training_step
from scjax.train.warm_start import denoiser_base, model_at, started
from scjax.viz import grid

_PICTURED = 8
_VALIDATION_DRAWS = 4  # times and noises a validation scene


def build(config) -> Stage:
    """The stage's functions from its resolved config."""
    frozen = load_model(config.autoencoder)
    codec, coder = frozen.codec, autoencoder(frozen.autoencoder.config)
    manifest = load_manifest(config.records)
    fields = config.model.to_dict()
    texts, images = _texts(config), config.condition == "image"
    fields |= {
        "condition": ImageCondition(len(CLASSES), GRID, patch=1) if images else texts and TextCondition(texts.width),
        "cross_attention": _control(config),
        "lane_latent": frozen.autoencoder.config.lane_latent,
        "agent_latent": frozen.autoencoder.config.agent_latent,
        "domains": max(len(manifest["domains"]), 1),
    }
    model = DenoiserConfig(**fields)
    network = denoiser(model)
    base = _base(config, frozen.autoencoder.params, manifest["domains"])
    shapes = jax.eval_shape(network.init, jax.random.key(0))
    kept = frozenset(flatten(base)) if config.freeze else frozenset()
    if model.relative_geometry:  # what reads the autoencoder's latents is fitted once
        kept |= {path for path in flatten(shapes) if path[0] == "position_heads"}
    packing = FlatParams.of(shapes, kept)
    optimizer = make_optimizer(config, packing)
    schedule = cosine_schedule()
    loss = config.loss
    timestep_sampling = TimestepSampling(distribution=loss.times, continuous=loss.continuous_times)
    validation = validation_examples(config, codec)
    bucket = config.batch.buckets[-1]
    # Closed over, not differentiated and not in the state: the frozen part is no part of a checkpoint.
    coder_params = jax.tree.map(jnp.asarray, frozen.autoencoder.params)

    def init(key: jax.Array) -> TrainState:
        return initial(started(network.init(key), base), packing, optimizer)

    @jax.jit
    def means(scene) -> PerType:
        return frozen.latents.normalize(coder.apply(coder_params, codec.normalize(scene), method="encode").mean)

    def prepare(state: TrainState) -> TrainState:
        if not model.relative_geometry or "position_heads" in base:
            return state
        batches = training_batches(config.records, codec, pipeline_config(config.batch.to_dict()))
        fitted = fit_anchors(batches, means, jax.random.fold_in(jax.random.key(config.seed), 2))
        params, ema = (
            packing.unpack(jax.device_get(x)) | {"position_heads": fitted} for x in (state.params, state.ema)
        )
        return state.replace(params=packing.pack(params), ema=packing.pack(ema))

    def latent_batch(batch: Example, key: jax.Array) -> LatentBatch:
        tokens = codec.normalize(batch.scene)
        posterior = coder.apply(coder_params, tokens, method="encode")
        latents = reparameterize(jax.random.fold_in(key, 0), posterior)
        masks = PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask)
        all_lanes = jax.random.bernoulli(jax.random.fold_in(key, 1), loss.known_lanes_share, tokens.crop.shape)
        known = PerType(agents=tokens.agent_behind, lanes=tokens.lane_behind | (all_lanes[:, None] & tokens.lane_mask))
        return LatentBatch(
            latents=frozen.latents.normalize(latents), masks=masks, known=known,
            label=model.domains * tokens.crop + tokens.domain,
            condition=condition_features(batch),
        )  # fmt: skip

    def penalty_of(masks: PerType, scene):
        def penalty(estimate: PerType, level):
            latents = frozen.latents.denormalize(estimate)
            made = decode(coder, coder_params, codec, latents, masks, scene.crop, scene.domain)
            total = jnp.zeros(len(scene.crop))
            if loss.collision:
                total += (
                    loss.collision
                    * collision_weight(level)
                    * collision_energy(made.replace(agent_types=scene.agent_types))
                )
            if loss.connections:
                total += loss.connections * relation_weight(level) * connection_error(made, scene)
            if loss.lateral_offsets:
                total += loss.lateral_offsets * relation_weight(level) * lateral_offset_error(made, scene)
            return total

        return penalty if loss.collision or loss.connections or loss.lateral_offsets else None

    def objective(params, example: Example, key):
        batch, key = latent_batch(example, jax.random.fold_in(key, 0)), jax.random.fold_in(key, 1)
        return training_loss(
            network, held(params, kept), schedule, batch, key, null_label=model.null_label,
            prediction=model.prediction, timestep_sampling=timestep_sampling, label_dropout=loss.label_dropout,
            condition_dropout=loss.condition_dropout, count_known=loss.count_known,
            penalty=penalty_of(batch.masks, example.scene),
        )  # fmt: skip

    def as_model(state: TrainState, notes: dict | None = None) -> Model:
        return dataclasses.replace(
            frozen.with_component("denoiser", model, packing.unpack(jax.device_get(state.ema))),
            domains=tuple(manifest["domains"]), counts=_counts(manifest, model),
            text_encoder="" if texts is None else texts.encoder, notes=notes or {},
        )  # fmt: skip

    @jax.jit
    def validation_loss(params, example, key):
        return objective(params, example, key)[1]

    def evaluate(state: TrainState) -> dict[str, float]:
        size, totals, params = config.batch.batch_size, [], packing.unpack(jax.device_get(state.ema))
        for draw in range(_VALIDATION_DRAWS):
            for start in range(0, len(validation) - len(validation) % size or len(validation), size):
                examples = batch_of(validation[start : start + size], bucket)
                key = jax.random.fold_in(jax.random.key(2), draw * len(validation) + start)
                totals.append(jax.device_get(validation_loss(params, examples, key)))
        return {name: float(np.mean([terms[name] for terms in totals])) for name in totals[0]}

    def pictures(state: TrainState, step: int, reporter: Reporter) -> None:
        chosen = validation[:: max(len(validation) // _PICTURED, 1)][:_PICTURED]
        real, conditions = [example.scene for example in chosen], [_like(example) for example in chosen]
        made = sample_many(jax.random.key(3), conditions, model=as_model(state))
        titles = [f"{kind} {i}" for i in range(len(real)) for kind in ("recorded", "sampled")]
        pairs = [scene for pair in zip(real, made, strict=True) for scene in pair]
        grid(pairs, columns=4, titles=titles, path=reporter.picture_path(step, "samples"))

    def export(state: TrainState, resolved: dict) -> Model:
        notes = {"stage": "denoiser", "steps": int(state.step), "records": manifest["hash"], "config": resolved}
        notes |= {"images": "scjax.camera.raycast"} if images else {}
        return as_model(state, {**notes, "autoencoder": frozen.notes})

    step = training_step(
        objective, packing, optimizer, ema_decay=config.ema_decay, seed=config.seed, batch_size=config.batch.batch_size
    )
    return Stage(codec, init, step, evaluate, pictures, export, texts, images, prepare)


def condition_features(batch: Example) -> ConditionFeatures | None:
    """What the network reads of a batch besides its scenes; None where that is nothing."""
    if batch.tokens is not None and batch.token_mask is not None:
        return TextFeatures(tokens=jnp.asarray(batch.tokens, jnp.float32), mask=batch.token_mask)
    if batch.image is not None and batch.depth is not None:
        return ImageFeatures(dino=batch.image, depth=batch.depth, present=batch.has_image)
    return None


def held(params: Params, kept: frozenset) -> Params:
    """``params`` whose leaves at paths in ``kept`` get no gradient, which spares its computation."""
    leaves = flatten(params)
    return unflatten({path: jax.lax.stop_gradient(leaf) if path in kept else leaf for path, leaf in leaves.items()})


def _base(config, autoencoder: Params, domains: Sequence[str]) -> Params:
    """Parameters to begin with; nothing without ``config.start``."""
    if config.start:
        return denoiser_base(model_at(config.start), autoencoder, domains)
    if config.freeze:
        raise ValueError("config.freeze keeps the parameters of a base as they are: name its folder in config.start")
    return {}


def _control(config) -> CrossAttentionOptions:
    """The conditioning mechanism that the config names, with its options."""
    options = config.cross_attention_options
    return from_name(
        config.cross_attention,
        **(options[config.cross_attention].to_dict() if config.cross_attention in options else {}),
    )


def _texts(config) -> TextStore | None:
    if config.condition not in ("none", "text", "image"):
        raise ValueError(f'config.condition is {config.condition!r}: choose "none", "text" or "image"')
    return TextStore(config.records, "train") if config.condition == "text" else None


def validation_examples(config, codec: SceneCodec) -> list[Example]:
    """Held-back scenes of ``config.records``, cut to the largest bucket as training scenes are: centred ones, with
    the first caption of each, or those ahead, with what stands in for their images."""
    crop = Crop.FORWARD if config.condition == "image" else Crop.CENTERED
    scenes = validation_scenes(config.records, codec, crop=crop, bucket=tuple(config.batch.buckets[-1]))
    if config.condition == "text":
        return with_captions(config, scenes)
    return [pictured(scene) if config.condition == "image" else Example(scene=scene) for scene in scenes]


def with_captions(config, scenes: Sequence[Scene]) -> list[Example]:
    """The held-back scenes of ``config.records``, in record order, each with the first of its captions."""
    store = TextStore(config.records, "val")
    return [
        captioned(scene, store.features(int(store.texts_of(row)[0])), config.batch.text_slots)
        for row, scene in enumerate(scenes)
    ]


def _like(example: Example) -> Condition:
    """Counts, domain, layout and caption or image of a scene."""
    scene = example.scene
    tokens = None
    if example.tokens is not None and example.token_mask is not None:
        tokens = np.asarray(example.tokens[example.token_mask], np.float32)
    return Condition(
        num_lanes=int(scene.num_lanes), num_agents=int(scene.num_agents), domain=int(scene.domain),
        crop=Crop(int(scene.crop)), tokens=tokens, image=example.image, depth=example.depth,
    )  # fmt: skip


def _counts(manifest: dict, model: DenoiserConfig) -> np.ndarray:
    """The joint table of the training split, centred tiles standing in for the other layouts."""
    counted = manifest["counts"]
    rows = ((domain, Crop.CENTERED, lanes, agents) for domain, lanes, agents, n in counted for _ in range(n))
    return count_table(rows, model.domains, max_lanes=model.max_lanes, max_agents=model.max_agents)
