"""Stage 2: the latent denoiser, trained on a frozen autoencoder that encodes every batch anew."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

import scjax
from experiments.reporting import Reporter
from experiments.state import Stage, TrainState, initial, training_step
from scjax.condition import Condition
from scjax.data.build import load_manifest
from scjax.data.pipeline import validation_scenes
from scjax.diffusion.loss import LatentBatch, training_loss
from scjax.diffusion.optimiser import adamw
from scjax.diffusion.schedule import cosine_schedule
from scjax.model import Model
from scjax.models.autoencoder.loss import reparameterise
from scjax.models.autoencoder.model import autoencoder
from scjax.models.counts import count_table
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.models.nodes import Nodes
from scjax.sampling import sample_many
from scjax.scene import Layout, pad, stack
from scjax.viz import grid

_PICTURED = 8
_VALIDATION_DRAWS = 4  # times and noises a validation scene


def build(config) -> Stage:
    """The stage's functions from its resolved config."""
    frozen = scjax.load(config.autoencoder)
    representation, coder = frozen.representation, autoencoder(frozen.autoencoder_config)
    manifest = load_manifest(config.records)
    fields = config.model.to_dict()
    fields |= {
        "lane_latent": frozen.autoencoder_config.lane_latent,
        "agent_latent": frozen.autoencoder_config.agent_latent,
        "domains": max(len(manifest["domains"]), 1),
    }
    model = DenoiserConfig(**fields)
    network = denoiser(model)
    schedule = cosine_schedule()
    optimiser = adamw(**config.optimiser.to_dict(), steps=config.steps)
    loss = config.loss
    validation = validation_scenes(config.records, representation)
    bucket = config.batch.buckets[-1]
    # Closed over, not differentiated and not in the state: the frozen part is no part of a checkpoint.
    coder_params = jax.tree.map(jnp.asarray, frozen.autoencoder)

    def init(key: jax.Array) -> TrainState:
        return initial(network.init(key), optimiser)

    def latent_batch(scenes, key: jax.Array) -> LatentBatch:
        tokens = representation.tokens(scenes)
        posterior = coder.apply(coder_params, tokens, method="encode")
        latents = reparameterise(jax.random.fold_in(key, 0), posterior)
        masks = Nodes(agents=tokens.agent_mask, lanes=tokens.lane_mask)
        all_lanes = jax.random.bernoulli(jax.random.fold_in(key, 1), loss.lanes_given, tokens.layout.shape)
        given = Nodes(agents=tokens.agent_before, lanes=tokens.lane_before | (all_lanes[:, None] & tokens.lane_mask))
        return LatentBatch(
            latents=frozen.latents.normalise(latents), masks=masks, given=given,
            label=model.domains * tokens.layout + tokens.domain,
        )  # fmt: skip

    def objective(params, scenes, key):
        batch, key = latent_batch(scenes, jax.random.fold_in(key, 0)), jax.random.fold_in(key, 1)
        return training_loss(
            network, params, schedule, batch, key, null_label=model.null_label, prediction=model.prediction,
            label_dropout=loss.label_dropout, condition_dropout=loss.condition_dropout, count_given=loss.count_given,
        )  # fmt: skip

    def as_model(state: TrainState, notes: dict | None = None) -> Model:
        return dataclasses.replace(
            frozen, denoiser=jax.device_get(state.ema), denoiser_config=model, domains=tuple(manifest["domains"]),
            counts=_counts(manifest, model), notes=notes or {},
        )  # fmt: skip

    @jax.jit
    def validation_loss(params, scenes, key):
        return objective(params, scenes, key)[1]

    def evaluate(state: TrainState) -> dict[str, float]:
        size, totals, params = config.batch.batch_size, [], jax.device_get(state.ema)
        for draw in range(_VALIDATION_DRAWS):
            for start in range(0, len(validation) - len(validation) % size or len(validation), size):
                scenes = stack([pad(scene, *bucket) for scene in validation[start : start + size]])
                key = jax.random.fold_in(jax.random.key(2), draw * len(validation) + start)
                totals.append(jax.device_get(validation_loss(params, scenes, key)))
        return {name: float(np.mean([terms[name] for terms in totals])) for name in totals[0]}

    def pictures(state: TrainState, step: int, reporter: Reporter) -> None:
        real = validation[:: max(len(validation) // _PICTURED, 1)][:_PICTURED]
        conditions = [
            Condition(num_lanes=int(s.num_lanes), num_agents=int(s.num_agents), domain=int(s.domain)) for s in real
        ]
        made = sample_many(jax.random.key(3), conditions, model=as_model(state))
        titles = [f"{kind} {i}" for i in range(len(real)) for kind in ("recorded", "sampled")]
        pairs = [scene for pair in zip(real, made, strict=True) for scene in pair]
        grid(pairs, columns=4, titles=titles, path=reporter.picture_path(step, "samples"))

    def export(state: TrainState, resolved: dict) -> Model:
        notes = {"stage": "denoiser", "steps": int(state.step), "records": manifest["hash"], "config": resolved}
        return as_model(state, {**notes, "autoencoder": frozen.notes})

    step = training_step(
        objective, optimiser, ema_decay=config.ema_decay, seed=config.seed, batch_size=config.batch.batch_size
    )
    return Stage(representation, init, step, evaluate, pictures, export)


def _counts(manifest: dict, model: DenoiserConfig) -> np.ndarray:
    """The joint table of the training split, centred tiles standing in for the other layouts."""
    counted = manifest["counts"]
    rows = ((domain, Layout.CENTRED, lanes, agents) for domain, lanes, agents, n in counted for _ in range(n))
    return count_table(rows, model.domains, max_lanes=model.max_lanes, max_agents=model.max_agents)
