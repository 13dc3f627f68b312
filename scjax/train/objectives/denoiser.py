"""The latent denoiser, trained on a frozen autoencoder that encodes every batch anew (official-spec §4-6)."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scjax.data.build import load_manifest
from scjax.data.caption_features import TextStore
from scjax.data.loader import LoaderConfig, TrainingExample, training_batches
from scjax.data.measurements import MeasuredRecords
from scjax.data.window_images import WindowImages
from scjax.diffusion.log_snr_schedule import log_snr_schedule
from scjax.diffusion.loss import LatentBatch, Penalty, training_loss
from scjax.diffusion.schedule import cosine_schedule
from scjax.diffusion.timestep_sampling import TimestepSampling
from scjax.generate.model import Model
from scjax.generate.outlines import Outlines
from scjax.generate.sample import sample_scenes
from scjax.generate.view_outlines import ViewOutlines
from scjax.language.attributes.vector import feature_names
from scjax.models.autoencoder.model import autoencoder
from scjax.models.autoencoder.outputs import reparameterize
from scjax.models.codec import SceneCodec
from scjax.models.counts.prior import count_table
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.kinds import LANE_DIGITS, agent_digits, scene_kinds
from scjax.models.denoiser.model import denoiser
from scjax.nn import random
from scjax.nn.cross_attention import from_name
from scjax.nn.functional import Functional, Params, Path, flatten, unflatten
from scjax.scene import Crop, Scene
from scjax.scene.partition import elements_behind
from scjax.scene.per_type import PerType
from scjax.train.fit_position_head import FitOptions, fit_position_heads
from scjax.train.objectives.base import PicturePath, Terms, every_nth, mean_terms
from scjax.train.objectives.denoiser_inputs import condition_features, condition_of, window_images
from scjax.train.objectives.known_elements import KnownShares, draw_known
from scjax.train.objectives.penalty import DecodedPenalty, PenaltyWeights
from scjax.train.objectives.record_outlines import outlines_of_records
from scjax.train.objectives.record_views import views_of_records
from scjax.train.objectives.validation_examples import validation_examples, validation_requests
from scjax.train.resume import captions_hash, model_hash, params_hash
from scjax.train.warm_start import denoiser_base, load_config_model, load_init_model, warm_start
from scjax.viz import grid

CONDITIONS = ("none", "text", "image")
_HEADS = "position_heads"  # parameters that are fitted to the autoencoder, not trained
_PICTURES = 8
_VALIDATED = 500  # validation scenes, evenly spaced: more would take minutes each time
_VALIDATION_REPEATS = 4  # times and noises per validation scene


@dataclasses.dataclass(frozen=True, kw_only=True)
class DenoiserLossOptions:
    """Options of ``diffusion.loss.training_loss`` that do not depend on the data.

    Attributes:
      timesteps: distribution of the noise levels.
      label_dropout, condition_dropout: share of scenes without a label and without a condition.
      kind_dropout: for each type of tokens, the share of scenes without kinds.
      known: shares of scenes with known elements.
      count_known: whether known tokens count in the loss means.
    """

    timesteps: TimestepSampling
    label_dropout: float
    condition_dropout: float
    kind_dropout: float
    known: KnownShares
    count_known: bool


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class DenoiserObjective:
    """See ``Objective``.

    Attributes:
      base: the model of ``config.autoencoder``, whose autoencoder is frozen.
      records: record folder; manifest: its description; validation: its held-back scenes.
      model: sizes of the network.
      loader: the training stream.
      texts, measurements, ahead, images: what batches carry besides scenes.
      init_params: parameters to begin with; freeze: whether these are frozen, but those of what reads the condition.
      options, penalties: of the loss.
      fit_options, seed: of the position heads.
    """

    base: Model
    records: str
    manifest: dict[str, Any]
    validation: list[TrainingExample]
    model: DenoiserConfig
    loader: LoaderConfig
    texts: TextStore | None
    measurements: MeasuredRecords | None
    ahead: MeasuredRecords | None
    images: WindowImages | None
    init_params: Params
    freeze: bool
    options: DenoiserLossOptions
    penalties: PenaltyWeights
    fit_options: FitOptions
    seed: int

    @classmethod
    def from_config(cls, config) -> DenoiserObjective:
        """The objective of a training config; reads records, captions and models.

        Raises:
          ValueError: unknown condition or mechanism, or ``freeze`` without ``init_from``.
        """
        if config.condition not in CONDITIONS:
            raise ValueError(f'config.condition is {config.condition!r}: choose "none", "text" or "image"')
        if config.freeze and not config.init_from:
            raise ValueError(
                "config.freeze freezes the parameters of a base model: name its folder in config.init_from"
            )
        base, manifest = load_config_model("autoencoder", config.autoencoder), load_manifest(config.records)
        texts = TextStore(config.records, "train") if config.condition == "text" else None
        loader = LoaderConfig.from_json(config.batch.to_dict())
        reads_others = config.attributes and any(loader.crops[: Crop.FORWARD])
        measurements = MeasuredRecords(config.records, "train") if reads_others else None
        images = window_images(config)
        ahead = None
        if images is not None and config.attributes:
            ahead = MeasuredRecords(config.records, "train", Crop.FORWARD)
        model = _network_config(config, base, manifest, texts, images)
        init_params = {}
        if config.init_from:
            init_model = load_init_model(config.init_from)
            init_params = denoiser_base(init_model, base.autoencoder.params, manifest["domains"])
        loss = config.loss
        return cls(
            base=base,
            records=config.records,
            manifest=manifest,
            validation=validation_examples(
                config.records,
                base.codec,
                condition=config.condition,
                attributes=config.attributes,
                images=None if images is None else images.of_split("val"),
                bucket=loader.buckets[-1],
                text_slots=loader.text_slots,
            ),
            model=model,
            loader=loader,
            texts=texts,
            measurements=measurements,
            ahead=ahead,
            images=images,
            init_params=init_params,
            freeze=config.freeze,
            options=DenoiserLossOptions(
                timesteps=TimestepSampling(distribution=loss.times, continuous=loss.continuous_times),
                label_dropout=loss.label_dropout,
                condition_dropout=loss.condition_dropout,
                kind_dropout=loss.kind_dropout,
                known=KnownShares(lanes=loss.known_lanes_share, region=loss.known_region_share),
                count_known=loss.count_known,
            ),
            penalties=PenaltyWeights(loss.collision, loss.connections, loss.lateral_offsets),
            fit_options=FitOptions(**config.position_head_fit.to_dict()),
            seed=config.seed,
        )

    @property
    def codec(self) -> SceneCodec:
        """That of the autoencoder."""
        return self.base.codec

    @property
    def network(self) -> Functional:
        """The denoiser as pure functions."""
        return denoiser(self.model)

    @functools.cached_property
    def frozen(self) -> frozenset[Path]:
        """Position heads, and with ``config.freeze`` all of the base model but what reads texts or pictures."""
        shapes, frozen = jax.eval_shape(self.network.init, jax.random.key(0)), frozenset()
        if self.freeze:
            unconditional = denoiser(dataclasses.replace(self.model, condition=None))
            without = flatten(jax.eval_shape(unconditional.init, jax.random.key(0)))
            frozen = frozenset(flatten(self.init_params)).intersection(without)
        return frozen | {path for path in flatten(shapes) if path[0] == _HEADS}

    @property
    def inputs(self) -> dict[str, str]:
        """Hashes of the records, captions, attributes, the frozen autoencoder, and the parameters to begin with."""
        captions = {} if self.texts is None else {"captions": captions_hash(self.records, self.texts.encoder)}
        stores = {"attributes": self.measurements, "attributes_ahead": self.ahead}
        measured = {name: store.sha256 for name, store in stores.items() if store is not None}
        start = {"init_from": params_hash(self.init_params)} if self.init_params else {}
        base = model_hash(self.base, "autoencoder")
        return {"records": self.manifest["hash"], "autoencoder": base, **captions, **measured, **start}

    def init(self, key: Array) -> Params:
        """Fresh parameters, and those of ``config.init_from`` where it has any."""
        return warm_start(self.network.init(key), self.init_params)

    def prepare(self, params: Params) -> Params:
        """Fits the position heads to the autoencoder, unless the base model brought them."""
        if not self.model.relative_geometry or _HEADS in self.init_params:
            return params
        batches = training_batches(self.records, self.codec, self.loader)
        key = jax.random.fold_in(jax.random.key(self.seed), 2)
        return params | {_HEADS: fit_position_heads(batches, self._mean_latents, key, self.fit_options)}

    def loss(self, params: Params, batch: TrainingExample, keys: Array) -> tuple[Array, Terms]:
        """The denoising loss at random noise levels, with random dropouts and known lanes."""
        scene, latents = self._latent_batch(batch, random.fold_in(keys, 0))
        penalty = None
        if self.penalties:
            penalty = DecodedPenalty(self.penalties, self.base, self._autoencoder_params, latents.masks, scene)
        return self.loss_of_latents(params, latents, random.fold_in(keys, 1), penalty)

    def loss_of_latents(
        self, params: Params, batch: LatentBatch, keys: Array, penalty: Penalty | None = None
    ) -> tuple[Array, Terms]:
        """The denoising loss of latents, with ``keys`` [B]."""
        return training_loss(
            self.network,
            stop_gradients(params, self.frozen),
            log_snr_schedule() if self.model.schedule == "log_snr" else cosine_schedule(),
            batch,
            keys,
            null_label=self.model.null_label,
            prediction=self.model.prediction,
            timestep_sampling=self.options.timesteps,
            label_dropout=self.options.label_dropout,
            condition_dropout=self.options.condition_dropout,
            kind_dropout=self.options.kind_dropout,
            count_known=self.options.count_known,
            penalty=penalty,
        )

    def evaluate(self, params: Params) -> dict[str, float]:
        """Loss terms of at most 500 validation scenes."""
        return mean_terms(
            self._terms,
            params,
            every_nth(self.validation, _VALIDATED),
            batch_size=self.loader.batch_size,
            bucket=self.loader.buckets[-1],
            key=jax.random.key(2),
            repeats=_VALIDATION_REPEATS,
        )

    def draw_pictures(self, params: Params, path_of: PicturePath) -> None:
        """Recorded scenes beside scenes sampled with their counts and condition."""
        examples = every_nth(self.validation, _PICTURES)
        reads_depth = isinstance(self.model.condition, ImageCondition) and self.model.condition.depth
        conditions = [condition_of(example, reads_depth) for example in examples]
        if self.model.attributes and self.images is None:
            requests = every_nth(validation_requests(self.records), _PICTURES)
            pairs = zip(conditions, requests, strict=True)
            conditions = [dataclasses.replace(condition, attributes=request) for condition, request in pairs]
        sampled = sample_scenes(jax.random.key(3), conditions, model=self._model(params))
        titles = [f"{name} {i}" for i in range(len(examples)) for name in ("recorded", "sampled")]
        scenes = [scene for example, other in zip(examples, sampled, strict=True) for scene in (example.scene, other)]
        grid(scenes, columns=4, titles=titles, path=path_of("samples"))

    def export(self, params: Params, notes: dict[str, Any]) -> Model:
        """The autoencoder's model with the trained denoiser."""
        seen = {} if self.images is None else {"images": self.images.encoder or "scjax.camera.raycast"}
        if self._keeps_base:
            own = {"steps": notes["steps"], "records": self.manifest["hash"], **seen}
            return dataclasses.replace(self._model(params), notes={**self.base.notes, "condition": own})
        notes = {"objective": "denoiser", "records": self.manifest["hash"], **notes, **seen}
        return dataclasses.replace(self._model(params), notes={**notes, "autoencoder": self.base.notes})

    @property
    def _keeps_base(self) -> bool:
        """Whether what a frozen denoiser came with stays: counts, outlines, other networks.

        It does if ``config.autoencoder`` is the model of that denoiser, with these domains.
        """
        has_denoiser = "denoiser" in self.base.components
        return self.freeze and has_denoiser and self.base.domains == tuple(self.manifest["domains"])

    def _model(self, params: Params) -> Model:
        model = self.base.with_component("denoiser", self.model, params)
        if not self._keeps_base:
            model = dataclasses.replace(
                model,
                domains=tuple(self.manifest["domains"]),
                counts=_count_table(self.manifest, self.model),
                outlines=self._outlines,
                text_encoder="",
            )
        if self.texts is not None:
            model = dataclasses.replace(model, text_encoder=self.texts.encoder)
        encoder = "" if self.images is None else self.images.encoder
        return dataclasses.replace(model, views=self._views, image_encoder=encoder)

    def _latent_batch(self, batch: TrainingExample, keys: Array) -> tuple[Scene, LatentBatch]:
        """Scenes and their latents, known tokens first."""
        behind = elements_behind(batch.scene)
        scene, known, apart = draw_known(random.fold_in(keys, 1), batch.scene, behind, self.options.known)
        tokens = self.codec.normalize(scene).replace(agent_behind=apart.agents, lane_behind=apart.lanes)
        posterior = autoencoder(self.base.autoencoder.config).apply(self._autoencoder_params, tokens, method="encode")
        latents = reparameterize(random.fold_in(keys, 0), posterior)
        return scene, LatentBatch(
            latents=self.base.latents.normalize(latents),
            masks=PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask),
            known=known,
            label=jnp.asarray(self.model.domains * tokens.crop + tokens.domain),
            attributes=None if batch.attributes is None else jnp.asarray(batch.attributes),
            kinds=scene_kinds(scene, self.codec) if self.model.agent_kinds else None,
            condition=condition_features(batch),
        )

    @functools.cached_property
    def _outlines(self) -> Outlines | None:
        measured = self.measurements
        bucket = self.model.max_agents, self.model.max_lanes
        return None if measured is None else outlines_of_records(self.records, measured, self.codec, bucket)

    @functools.cached_property
    def _views(self) -> ViewOutlines | None:
        if self.images is None or not self.images.encoder or not self.model.agent_kinds:
            return None
        bucket = self.model.max_agents, self.model.max_lanes
        return views_of_records(self.records, self.images, self.codec, bucket)

    @functools.cached_property
    def _autoencoder_params(self) -> Params:
        """Constants of the loss: neither differentiated nor part of checkpoints."""
        with jax.ensure_compile_time_eval():  # arrays, also where a trace asks first
            return jax.device_put(self.base.autoencoder.params)

    @functools.cached_property
    def _mean_latents(self) -> Callable[[Scene], PerType]:
        """Scenes -> normalized means of their latents."""

        @jax.jit
        def encode(scene: Scene) -> PerType:
            network = autoencoder(self.base.autoencoder.config)
            posterior = network.apply(self._autoencoder_params, self.codec.normalize(scene), method="encode")
            return self.base.latents.normalize(posterior.mean)

        return encode

    @functools.cached_property
    def _terms(self) -> Callable[[Params, TrainingExample, Array], Terms]:
        return jax.jit(lambda params, batch, keys: self.loss(params, batch, keys)[1])


def stop_gradients(params: Params, frozen: frozenset[Path]) -> Params:
    """``params`` whose leaves at paths in ``frozen`` get no gradient, so that none is computed."""
    leaves = flatten(params)
    return unflatten({path: jax.lax.stop_gradient(leaf) if path in frozen else leaf for path, leaf in leaves.items()})


def _network_config(
    config, base: Model, manifest: dict[str, Any], texts: TextStore | None, images: WindowImages | None
) -> DenoiserConfig:
    """The sizes of ``config.model``, with the mechanism of ``config.cross_attention``, for these data and latents."""
    name, options = config.cross_attention, config.cross_attention_options
    condition = None if texts is None else TextCondition(texts.width)
    if images is not None:
        condition = ImageCondition(images.channels, images.grid, patch=1, depth=config.image_depth)
    fields = config.model.to_dict() | {
        "condition": condition,
        "attributes": feature_names() if config.attributes else (),
        "agent_kinds": agent_digits(base.codec) if config.attributes else (),
        "lane_kinds": LANE_DIGITS if config.attributes else (),
        "cross_attention": from_name(name, **(options[name].to_dict() if name in options else {})),
        "lane_latent": base.autoencoder.config.lane_latent,
        "agent_latent": base.autoencoder.config.agent_latent,
        "domains": max(len(manifest["domains"]), 1),
    }
    return DenoiserConfig(**fields)


def _count_table(manifest: dict[str, Any], model: DenoiserConfig) -> np.ndarray:
    """The joint table of the training split; centered tiles serve for the other crops."""
    rows = (
        (domain, Crop.CENTERED, lanes, agents)
        for domain, lanes, agents, number in manifest["counts"]
        for _ in range(number)
    )
    return count_table(rows, model.domains, max_lanes=model.max_lanes, max_agents=model.max_agents)
