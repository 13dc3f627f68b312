"""The network that predicts lane and agent counts (f_count), trained on captions or on requests for attributes."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array

from scjax.data.build import load_manifest
from scjax.data.caption_features import TextStore
from scjax.data.loader import Bucket, LoaderConfig, TrainingExample, validation_scenes
from scjax.data.measurements import MeasuredRecords
from scjax.generate.model import Model
from scjax.language.attributes.vector import feature_names
from scjax.models.codec import SceneCodec
from scjax.models.counts.predictor import CountPredictorConfig, count_loss, count_predictor
from scjax.models.denoiser.context import TextFeatures
from scjax.nn import random
from scjax.nn.functional import Functional, Params, Path
from scjax.train.objectives.base import PicturePath, Terms, mean_terms
from scjax.train.objectives.validation_examples import first_captions, validation_examples
from scjax.train.resume import captions_hash, model_hash
from scjax.train.warm_start import load_config_model


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CountObjective:
    """See ``Objective``.

    Attributes:
      base: the model of ``config.denoiser``, which the trained network joins.
      records: record folder; records_hash: from its manifest.
      texts: captions of the training split, or None; measurements: its attributes, or None. One of them is given.
      validation: held-back scenes with a caption or a request each.
      model: sizes of the network.
      domain_dropout: share of examples whose domain is hidden.
      batch_size, bucket: of validation batches.
    """

    base: Model
    records: str
    records_hash: str
    texts: TextStore | None
    measurements: MeasuredRecords | None
    validation: list[TrainingExample]
    model: CountPredictorConfig
    domain_dropout: float
    batch_size: int
    bucket: Bucket

    ahead: ClassVar[None] = None
    images: ClassVar[None] = None
    frozen: ClassVar[frozenset[Path]] = frozenset()

    @classmethod
    def from_config(cls, config) -> CountObjective:
        """The objective of a training config; reads records and the model of ``config.denoiser``.

        Raises:
          ValueError: that model reads other texts than the records have.
        """
        base = load_config_model("denoiser", config.denoiser)
        loader = LoaderConfig.from_json(config.batch.to_dict())
        bucket = loader.buckets[-1]
        if config.condition == "attributes":
            texts, measurements, names = None, MeasuredRecords(config.records, "train"), feature_names()
            validation = validation_examples(
                config.records, base.codec, condition="none", attributes=True, bucket=bucket, text_slots=1
            )
        else:
            texts, measurements, names = _texts(config, base), None, ()
            scenes = validation_scenes(config.records, base.codec, bucket=bucket)
            validation = first_captions(config.records, scenes, loader.text_slots)
        return cls(
            base=base,
            records=config.records,
            records_hash=load_manifest(config.records)["hash"],
            texts=texts,
            measurements=measurements,
            validation=validation,
            model=CountPredictorConfig(
                text_width=len(names) if texts is None else texts.width,
                attributes=names,
                domains=len(base.domains),
                **config.model.to_dict(),
            ),
            domain_dropout=config.domain_dropout,
            batch_size=config.batch.batch_size,
            bucket=bucket,
        )

    @property
    def codec(self) -> SceneCodec:
        """That of the model."""
        return self.base.codec

    @property
    def network(self) -> Functional:
        """The count predictor as pure functions."""
        return count_predictor(self.model)

    @property
    def inputs(self) -> dict[str, str]:
        """Hashes of the records, their captions or attributes, and the model that the network joins."""
        base = model_hash(self.base, *sorted(self.base.components), domains=self.base.domains)
        captions = {} if self.texts is None else {"captions": captions_hash(self.records, self.texts.encoder)}
        measured = {} if self.measurements is None else {"attributes": self.measurements.sha256}
        return {"records": self.records_hash, **captions, **measured, "denoiser": base}

    def init(self, key: Array) -> Params:
        """Fresh parameters."""
        return self.network.init(key)

    def prepare(self, params: Params) -> Params:
        """Nothing is fitted beforehand."""
        return params

    def loss(self, params: Params, batch: TrainingExample, keys: Array) -> tuple[Array, Terms]:
        """-log P of the true counts given the caption or request and, in a share of examples, the domain."""
        is_known = random.bernoulli(keys, 1 - self.domain_dropout, batch.scene.domain.shape)
        domain = jnp.where(is_known, batch.scene.domain, self.model.domains)
        tables = self.network.apply(params, _tokens(batch), domain)
        lanes = jnp.minimum(batch.scene.lane_mask.sum(-1), self.model.max_lanes)
        agents = jnp.minimum(batch.scene.agent_mask.sum(-1), self.model.max_agents)
        return count_loss(tables, lanes, agents)

    def evaluate(self, params: Params) -> dict[str, float]:
        """Loss terms of the validation examples."""
        return mean_terms(
            self._terms, params, self.validation, batch_size=self.batch_size, bucket=self.bucket, key=jax.random.key(2)
        )

    def draw_pictures(self, params: Params, path_of: PicturePath) -> None:
        """Counts have no pictures."""

    def export(self, params: Params, notes: dict[str, Any]) -> Model:
        """The base model with the trained network."""
        model = self.base.with_component("count_predictor", self.model, params)
        return dataclasses.replace(model, notes={**self.base.notes, "count_predictor": notes})

    @functools.cached_property
    def _terms(self) -> Callable[[Params, TrainingExample, Array], Terms]:
        return jax.jit(lambda params, batch, keys: self.loss(params, batch, keys)[1])


def _tokens(batch: TrainingExample) -> TextFeatures:
    """The condition as tokens: those of a caption, or the vector of a request as one token, none if it is empty."""
    if batch.attributes is not None:
        vectors = jnp.asarray(batch.attributes)[..., None, :]
        return TextFeatures(tokens=vectors, mask=(vectors != 0).any(-1))
    return TextFeatures(tokens=jnp.asarray(batch.tokens, jnp.float32), mask=jnp.asarray(batch.token_mask))


def _texts(config, base: Model) -> TextStore:
    """The captions of the training split; ValueError if the model reads others."""
    texts = TextStore(config.records, "train")
    if base.text_encoder != texts.encoder:
        raise ValueError(
            f"config.denoiser: {config.denoiser} was trained on {base.text_encoder or 'no text'}, the captions of "
            f"{config.records} are embedded by {texts.encoder}: give the text-conditioned model of these records"
        )
    return texts
