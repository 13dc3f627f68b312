"""The vectorized autoencoder, trained to reproduce scenes (official-spec §2)."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, ClassVar, cast

import jax
import numpy as np
from jaxtyping import Array

from scjax.data.build import load_manifest
from scjax.data.loader import LoaderConfig, TrainingExample, training_batches, validation_scenes
from scjax.generate.model import Component, Model
from scjax.generate.reconstruct import reconstruct
from scjax.metrics.reconstruction import reconstruction
from scjax.models import codec as presets
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.loss import LossWeights
from scjax.models.autoencoder.loss import loss as autoencoder_loss
from scjax.models.autoencoder.model import autoencoder, noise_like
from scjax.models.autoencoder.outputs import reparameterize
from scjax.models.codec import SceneCodec
from scjax.models.latents import LatentStatistics, statistics
from scjax.nn.functional import Functional, Params, Path
from scjax.nn.random import row_keys
from scjax.scene import Scene
from scjax.scene.per_type import PerType
from scjax.train.objectives.base import PicturePath, Terms, every_nth
from scjax.train.resume import params_hash
from scjax.train.warm_start import load_init_model, warm_start
from scjax.viz import grid

_STATISTICS_BATCHES = 50
_PICTURES = 6


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class AutoencoderObjective:
    """See ``Objective``.

    Attributes:
      records: record folder; domains, records_hash: from its manifest; validation: its held-back scenes.
      model: sizes of the network.
      weights, loss_options: of ``models.autoencoder.loss.loss``.
      loader: the stream that the latent statistics are taken from.
      init_params: parameters to begin with; empty: fresh ones.
    """

    records: str
    domains: tuple[str, ...]
    records_hash: str
    validation: list[Scene]
    codec: SceneCodec
    model: AutoencoderConfig
    weights: LossWeights
    loss_options: dict[str, Any]
    loader: LoaderConfig
    init_params: Params

    texts: ClassVar[None] = None
    measurements: ClassVar[None] = None
    ahead: ClassVar[None] = None
    images: ClassVar[None] = None
    frozen: ClassVar[frozenset[Path]] = frozenset()

    @classmethod
    def from_config(cls, config) -> AutoencoderObjective:
        """The objective of a training config; reads records and the model of ``config.init_from``."""
        codec = presets.PRESETS[config.codec]()
        manifest = load_manifest(config.records)
        options = config.loss.to_dict()
        return cls(
            records=config.records,
            domains=tuple(manifest["domains"]),
            records_hash=manifest["hash"],
            validation=validation_scenes(config.records, codec),
            codec=codec,
            model=AutoencoderConfig(**config.model.to_dict()),
            weights=LossWeights(**options.pop("weights")),
            loss_options=options,
            loader=LoaderConfig.from_json(config.batch.to_dict(), seed=1),
            init_params=load_init_model(config.init_from).autoencoder.params if config.init_from else {},
        )

    @property
    def network(self) -> Functional:
        """The autoencoder as pure functions."""
        return autoencoder(self.model)

    @property
    def inputs(self) -> dict[str, str]:
        """Hashes of the records, and of the parameters to begin with."""
        start = {"init_from": params_hash(self.init_params)} if self.init_params else {}
        return {"records": self.records_hash, **start}

    def init(self, key: Array) -> Params:
        """Fresh parameters, or those of ``config.init_from``."""
        return warm_start(self.network.init(key), self.init_params)

    def prepare(self, params: Params) -> Params:
        """Nothing is fitted beforehand."""
        return params

    def loss(self, params: Params, batch: TrainingExample, keys: Array) -> tuple[Array, Terms]:
        """The reconstruction loss with latents drawn from the posterior."""
        tokens = self.codec.normalize(batch.scene)
        noise = noise_like(keys, tokens, self.model)
        posterior, decoded = self.network.apply(params, tokens, noise, method="reconstruct")
        return cast(Any, autoencoder_loss(decoded, posterior, tokens, self.weights, **self.loss_options))

    def evaluate(self, params: Params) -> dict[str, float]:
        """Reconstruction errors of the validation scenes."""
        decoded = reconstruct(self._model(params), self.validation)
        return reconstruction(zip(self.validation, decoded, strict=True))

    def draw_pictures(self, params: Params, path_of: PicturePath) -> None:
        """Recorded scenes beside decoded ones."""
        scenes = every_nth(self.validation, _PICTURES)
        decoded = reconstruct(self._model(params), scenes)
        titles = [f"{name} {i}" for i in range(len(scenes)) for name in ("recorded", "decoded")]
        pairs = [scene for pair in zip(scenes, decoded, strict=True) for scene in pair]
        grid(pairs, columns=4, titles=titles, path=path_of("reconstruction"))

    def export(self, params: Params, notes: dict[str, Any]) -> Model:
        """The autoencoder with the statistics of its latents on training batches."""
        batches = training_batches(self.records, self.codec, self.loader)
        latents, masks = [], []
        for _ in range(_STATISTICS_BATCHES):
            batch = next(batches)
            keys = row_keys(jax.random.key(1), np.asarray(batch.index))
            latents.append(jax.device_get(self._draw_latents(params, batch.scene, keys)))
            masks.append(PerType(agents=np.asarray(batch.scene.agent_mask), lanes=np.asarray(batch.scene.lane_mask)))
        notes = {"objective": "autoencoder", "records": self.records_hash, **notes}
        return dataclasses.replace(self._model(params), latents=statistics(latents, masks), notes=notes)

    def _model(self, params: Params) -> Model:
        return Model(
            components={"autoencoder": Component(self.model, params)},
            codec=self.codec,
            latents=LatentStatistics.identity(),
            domains=self.domains,
        )

    @functools.cached_property
    def _draw_latents(self):
        """(parameters, scenes, keys) -> latents drawn from the posterior."""

        @jax.jit
        def draw(params: Params, scene: Scene, keys: Array) -> PerType:
            tokens = self.codec.normalize(scene)
            return reparameterize(keys, self.network.apply(params, tokens, method="encode"))

        return draw
