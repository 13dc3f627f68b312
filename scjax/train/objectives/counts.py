"""Stage 3: the network that tells counts from a prompt (f_count), trained on the captions of the records."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from scjax.data.caption_features import TextStore
from scjax.data.loader import Example, batch_of, validation_scenes
from scjax.generate.model import Model, load_model
from scjax.models.counts.predictor import CountPredictorConfig, count_loss, count_predictor
from scjax.models.denoiser.context import TextFeatures
from scjax.train.flat_params import FlatParams
from scjax.train.objectives.denoiser import with_captions
from scjax.train.reporter import Reporter
from scjax.train.step import Stage, TrainState, initial, make_optimizer, training_step


def build(config) -> Stage:
    """The stage's functions from its resolved config; the trained network joins the model of ``config.denoiser``."""
    base = load_model(config.denoiser)
    texts = TextStore(config.records, "train")
    if base.text_encoder != texts.encoder:
        raise ValueError(
            f"config.denoiser: {config.denoiser} was trained on {base.text_encoder or 'no text'}, the captions of "
            f"{config.records} are embedded by {texts.encoder}: give the text-conditioned model of these records"
        )
    domains = len(base.domains)
    model = CountPredictorConfig(text_width=texts.width, domains=domains, **config.model.to_dict())
    network = count_predictor(model)
    packing = FlatParams.of(jax.eval_shape(network.init, jax.random.key(0)))
    optimizer = make_optimizer(config, packing)
    bucket = tuple(config.batch.buckets[-1])
    validation = with_captions(config, validation_scenes(config.records, base.codec, bucket=bucket))

    def init(key: jax.Array) -> TrainState:
        return initial(network.init(key), packing, optimizer)

    def objective(params, example: Example, key):
        told = jax.random.bernoulli(key, 1 - config.domain_dropout, example.scene.domain.shape)
        domain = jnp.where(told, example.scene.domain, domains)
        text = TextFeatures(tokens=example.tokens.astype(jnp.float32), mask=example.token_mask)
        tables = network.apply(params, text, domain)
        lanes = jnp.minimum(example.scene.lane_mask.sum(-1), model.max_lanes)
        agents = jnp.minimum(example.scene.agent_mask.sum(-1), model.max_agents)
        return count_loss(tables, lanes, agents)

    @jax.jit
    def held_back(params, example, key):
        return objective(params, example, key)[1]

    def evaluate(state: TrainState) -> dict[str, float]:
        size, found, params = config.batch.batch_size, [], packing.unpack(jax.device_get(state.ema))
        for start in range(0, len(validation) - len(validation) % size or len(validation), size):
            batch = batch_of(validation[start : start + size], bucket)
            found.append(jax.device_get(held_back(params, batch, jax.random.key(start))))
        return {name: float(np.mean([terms[name] for terms in found])) for name in found[0]}

    def pictures(state: TrainState, step: int, reporter: Reporter) -> None:
        """Counts are no pictures."""

    def export(state: TrainState, resolved: dict) -> Model:
        notes = {**base.notes, "count_predictor": {"steps": int(state.step), "config": resolved}}
        params = packing.unpack(jax.device_get(state.ema))
        return dataclasses.replace(base.with_component("count_predictor", model, params), notes=notes)

    step = training_step(
        objective, packing, optimizer, ema_decay=config.ema_decay, seed=config.seed, batch_size=config.batch.batch_size
    )
    return Stage(base.codec, init, step, evaluate, pictures, export, texts)
