"""Stage 4: the decoder alone, trained on with latents as imprecise as samples are; encoder and latents stay.

Sampled latents miss their place by a share of the latents' spread, of which an autoencoder trained on its own
posterior (a hundredth of that spread) knows nothing: lanes then end beside the lane that they join. A decoder that has
seen such latents reconciles the tokens of a scene (noise-augmented decoding, Zheng et al. 2025, arXiv:2510.11690).
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

import scjax
from experiments.reporting import Reporter
from experiments.state import Stage, TrainState, initial, training_step
from scjax.data.pipeline import validation_scenes
from scjax.diffusion.optimiser import adamw
from scjax.metrics.realism import realism
from scjax.metrics.reconstruction import reconstruction
from scjax.model import Model
from scjax.models.autoencoder.loss import LossWeights, loss, reparameterise
from scjax.models.autoencoder.model import autoencoder
from scjax.models.latents import perturbed
from scjax.models.nodes import Nodes
from scjax.sampling import reconstruct
from scjax.viz import grid

_PICTURED = 4
_SHARES = (0.0, 0.1, 0.3)  # of the latents' spread, in the evaluation


def build(config) -> Stage:
    """The stage's functions from its resolved config; the trained decoder replaces that of ``config.start``."""
    base = scjax.load(config.start)
    if base.autoencoder is None or base.autoencoder_config is None:
        raise ValueError(f"config.start: the model {config.start} has no autoencoder: train that stage first")
    representation, encoder = base.representation, jax.tree.map(jnp.asarray, base.autoencoder["encoder"])
    network = autoencoder(base.autoencoder_config)
    options = config.loss.to_dict()
    weights = LossWeights(**options.pop("weights"))
    most = options.pop("latent_noise")
    if not most > 0:
        raise ValueError(f"config.loss.latent_noise is {most}, but must be above 0: latents without noise are stage 1")
    optimiser = adamw(**config.optimiser.to_dict(), steps=config.steps)
    validation = validation_scenes(config.records, representation)

    def init(key: jax.Array) -> TrainState:
        del key  # nothing is drawn
        return initial(jax.tree.map(jnp.array, base.autoencoder["decoder"]), optimiser)

    def objective(params, batch, key):
        tokens = representation.tokens(batch.scene)
        own, share, noise = jax.random.split(key, 3)
        posterior = network.apply({"encoder": encoder, "decoder": params}, tokens, method="encode")
        scenes = len(tokens.agent_mask)
        shares, keys = most * jax.random.normal(share, (scenes,)), jax.random.split(noise, scenes)
        latents = jax.vmap(perturbed, (0, 0, None, 0))(keys, reparameterise(own, posterior), base.latents.std, shares)
        masks = Nodes(agents=tokens.agent_mask, lanes=tokens.lane_mask)
        decoded = network.apply({"encoder": encoder, "decoder": params}, latents, masks, method="decode")
        return loss(decoded, posterior, tokens, weights, **options)

    def as_model(state: TrainState, notes: dict | None = None) -> Model:
        params = {"encoder": base.autoencoder["encoder"], "decoder": jax.device_get(state.ema)}
        return dataclasses.replace(base, autoencoder=params, notes=notes or {})

    def evaluate(state: TrainState) -> dict[str, float]:
        model, found = as_model(state), {}
        for share in _SHARES:
            decoded = reconstruct(model, validation, noise=share, key=jax.random.key(0))
            errors = reconstruction(zip(validation, decoded, strict=True)) | realism(decoded)
            found |= {f"{name}_at_{share}": value for name, value in errors.items()}
        return found

    def pictures(state: TrainState, step: int, reporter: Reporter) -> None:
        chosen = validation[:: max(len(validation) // _PICTURED, 1)][:_PICTURED]
        rows = [reconstruct(as_model(state), chosen, noise=share, key=jax.random.key(0)) for share in _SHARES]
        scenes = [*chosen, *(scene for row in rows for scene in row)]
        titles = [name for name in ("recorded", *(f"noise {share}" for share in _SHARES)) for _ in chosen]
        grid(scenes, columns=_PICTURED, titles=titles, path=reporter.picture_path(step, "noised"))

    def export(state: TrainState, resolved: dict) -> Model:
        return as_model(state, {**base.notes, "decoder": {"steps": int(state.step), "config": resolved}})

    step = training_step(
        objective, optimiser, ema_decay=config.ema_decay, seed=config.seed, batch_size=config.batch.batch_size
    )
    return Stage(representation, init, step, evaluate, pictures, export)
