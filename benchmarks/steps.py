"""The training steps and samplers' networks that are timed: small models on the workload."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import workload
from scjax.diffusion.loss import LatentBatch, training_loss
from scjax.diffusion.schedule import cosine_schedule
from scjax.models import codec as presets
from scjax.models import flops
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.loss import loss
from scjax.models.autoencoder.model import autoencoder, noise_like
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ImageFeatures, TextFeatures
from scjax.models.denoiser.model import denoiser
from scjax.nn.functional import Functional
from scjax.scene.per_type import PerType

KINDS = ("autoencoder", "unconditional", "text", "image")
TEXT = TextCondition(width=4096)
IMAGE = ImageCondition()
CONTEXT = {"unconditional": 0, "text": 512, "image": 392}


class Step(NamedTuple):
    """One kind of training step.

    Attributes:
      network: what is trained.
      objective: (parameters, batch, key) -> (loss, metrics).
      inputs: the batches of the workload.
      useful_flops: FLOPs of a step by the real lanes and agents of a scene, in closed form.
    """

    network: Functional
    objective: Callable[..., Any]
    inputs: Sequence[Any]
    useful_flops: Callable[[int, int], float]


def step_of(kind: str, batch: int, scenes: int, compute: str, size: str = "small") -> Step:
    """A step on ``scenes`` of the workload, ``batch`` at a time; ``size`` is a preset of the networks."""
    parts = workload.batches(batch, scenes)
    if kind == "autoencoder":
        config = autoencoder_config(compute, size)
        network, codec = autoencoder(config), presets.scjax()

        def reconstruction(params, batch, key):
            tokens = codec.normalize(batch)
            posterior, decoded = network.apply(params, tokens, noise_like(key, tokens, config), method="reconstruct")
            return loss(decoded, posterior, tokens, official_lane_count=False, balanced_links=True)

        return Step(
            network, reconstruction, parts, lambda lanes, agents: 3 * flops.autoencoder_forward(config, lanes, agents)
        )

    config = denoiser_config(kind, compute, size)
    network, schedule = denoiser(config), cosine_schedule()

    def denoising(params, batch, key):
        return training_loss(
            network, params, schedule, batch, key, null_label=config.null_label, prediction=config.prediction
        )

    return Step(
        network,
        denoising,
        [latents(part, config, kind) for part in parts],
        lambda lanes, agents: 3 * flops.denoiser_forward(config, lanes, agents, CONTEXT[kind]),
    )


def autoencoder_config(compute: str, size: str = "small") -> AutoencoderConfig:
    """The autoencoder with scjax's own classes and points of three coordinates."""
    own = AutoencoderConfig.preset("small")
    classes = {name: getattr(own, name) for name in ("lane_types", "agent_types", "link_types", "point_dims")}
    return AutoencoderConfig.preset(size, compute=compute, **classes)


def denoiser_config(kind: str, compute: str, size: str = "small") -> DenoiserConfig:
    """The denoiser of a preset, with its condition."""
    condition = {"unconditional": None, "text": TEXT, "image": IMAGE}[kind]
    return DenoiserConfig.preset(size, condition=condition, compute=compute)


def features(kind: str, scenes: int) -> TextFeatures | ImageFeatures | None:
    """Random condition features, all text tokens valid."""
    rng = np.random.default_rng(2)
    if kind == "text":
        tokens = rng.normal(size=(scenes, 512, TEXT.width)).astype(np.float32)
        return TextFeatures(tokens=tokens, mask=np.ones((scenes, 512), bool))
    if kind == "image":
        dino = rng.normal(size=(scenes, IMAGE.channels, *IMAGE.grid)).astype(np.float32)
        return ImageFeatures(dino=dino, depth=rng.random((scenes, 384, 672), np.float32))
    return None


def latents(scenes, config: DenoiserConfig, kind: str) -> LatentBatch:
    """Random latents of a batch's size."""
    rng = np.random.default_rng(3)
    masks = PerType(agents=jnp.asarray(scenes.agent_mask), lanes=jnp.asarray(scenes.lane_mask))
    widths = PerType(agents=config.agent_latent, lanes=config.lane_latent)
    values = jax.tree.map(
        lambda mask, width: jnp.asarray(rng.normal(size=(*mask.shape, width)), jnp.float32), masks, widths
    )
    return LatentBatch(
        latents=values,
        masks=masks,
        known=jax.tree.map(jnp.zeros_like, masks),
        label=jnp.zeros(len(scenes.crop), jnp.int32),
        condition=features(kind, len(scenes.crop)),
    )
