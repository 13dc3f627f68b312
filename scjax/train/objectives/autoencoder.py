"""Stage 1: the vectorized autoencoder, trained to reproduce scenes."""

from __future__ import annotations

import jax
import numpy as np

from scjax.data.build import load_manifest
from scjax.data.loader import training_batches, validation_scenes
from scjax.generate.model import Component, Model
from scjax.generate.sample import reconstruct
from scjax.metrics.reconstruction import reconstruction
from scjax.models import codec as presets
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.loss import LossWeights, loss
from scjax.models.autoencoder.model import autoencoder, noise_like
from scjax.models.autoencoder.outputs import reparameterize
from scjax.models.latents import LatentStatistics, statistics
from scjax.scene.per_type import PerType
from scjax.train.flat_params import FlatParams
from scjax.train.reporter import Reporter
from scjax.train.step import Stage, TrainState, initial, make_optimizer, pipeline_config, training_step
from scjax.train.warm_start import model_at, started
from scjax.viz import grid

_STATISTICS_BATCHES = 50
_PICTURED = 6


def build(config) -> Stage:
    """The stage's functions from its resolved config."""
    codec = presets.PRESETS[config.codec]()
    model = AutoencoderConfig(**config.model.to_dict())
    network = autoencoder(model)
    options = config.loss.to_dict()
    weights = LossWeights(**options.pop("weights"))
    packing = FlatParams.of(jax.eval_shape(network.init, jax.random.key(0)))
    optimizer = make_optimizer(config, packing)
    manifest = load_manifest(config.records)
    validation = validation_scenes(config.records, codec)
    base = model_at(config.start).autoencoder.params if config.start else {}

    def init(key: jax.Array) -> TrainState:
        return initial(started(network.init(key), base), packing, optimizer)

    def objective(params, batch, key):
        tokens = codec.normalize(batch.scene)
        posterior, decoded = network.apply(params, tokens, noise_like(key, tokens, model), method="reconstruct")
        return loss(decoded, posterior, tokens, weights, **options)

    def as_model(state: TrainState, latents: LatentStatistics | None = None, notes: dict | None = None) -> Model:
        return Model(
            components={"autoencoder": Component(model, packing.unpack(jax.device_get(state.ema)))},
            codec=codec,
            latents=latents or LatentStatistics.identity(),
            domains=tuple(manifest["domains"]),
            notes=notes or {},
        )

    def evaluate(state: TrainState) -> dict[str, float]:
        decoded = reconstruct(as_model(state), validation)
        return reconstruction(zip(validation, decoded, strict=True))

    def pictures(state: TrainState, step: int, reporter: Reporter) -> None:
        chosen = validation[:: max(len(validation) // _PICTURED, 1)][:_PICTURED]
        decoded = reconstruct(as_model(state), chosen)
        titles = [f"{kind} {i}" for i in range(len(chosen)) for kind in ("recorded", "decoded")]
        pairs = [scene for pair in zip(chosen, decoded, strict=True) for scene in pair]
        grid(pairs, columns=4, titles=titles, path=reporter.picture_path(step, "reconstruction"))

    def export(state: TrainState, resolved: dict) -> Model:
        params = packing.unpack(jax.device_get(state.ema))

        @jax.jit
        def sampled(params, scene, key):
            return reparameterize(key, network.apply(params, codec.normalize(scene), method="encode"))

        stream = training_batches(config.records, codec, pipeline_config(resolved["batch"], seed=1))
        latents, masks = [], []
        for i in range(_STATISTICS_BATCHES):
            scene = next(stream).scene
            draw = sampled(params, scene, jax.random.fold_in(jax.random.key(1), i))
            latents.append(jax.tree.map(np.asarray, draw))
            masks.append(PerType(agents=np.asarray(scene.agent_mask), lanes=np.asarray(scene.lane_mask)))
        notes = {"stage": "autoencoder", "steps": int(state.step), "records": manifest["hash"], "config": resolved}
        return as_model(state, statistics(latents, masks), notes)

    step = training_step(
        objective, packing, optimizer, ema_decay=config.ema_decay, seed=config.seed, batch_size=config.batch.batch_size
    )
    return Stage(codec, init, step, evaluate, pictures, export)
