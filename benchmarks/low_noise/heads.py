"""How exactly position heads read lane ends, and the offsets between linked ends, off clean latents."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np

from benchmarks.low_noise.noise import padded_batches
from scjax.generate.compiled import encode_program
from scjax.generate.model import Model
from scjax.models.denoiser.position_head import UNIT, position_heads
from scjax.scene import Link, Scene


def head_errors(model: Model, scenes: Sequence[Scene]) -> dict[str, list[float]]:
    """Quantiles 0.5 and 0.9 of the errors [m] of lane ends and of the offsets from an end to a successor's start."""
    config = model.denoiser.config
    read = jax.jit(position_heads(config.agent_latent, config.lane_latent).apply)
    ends, offsets = [], []
    for padded, kept in padded_batches(scenes):
        statistics = model.latents.mean, model.latents.std
        masks, latents = encode_program(model.codec, model.autoencoder.config)(
            model.autoencoder.params, *statistics, padded
        )
        error = UNIT * np.asarray(read(model.denoiser.params["position_heads"], latents).lanes)[:, :, (0, -1)]
        error = error - np.asarray(padded.lanes)[:, :, (0, -1), :2]
        valid = np.asarray(masks.lanes) & kept[:, None]
        linked = (np.asarray(padded.links) == Link.PREDECESSOR) & valid[:, :, None]
        ends.append(np.linalg.norm(error, axis=-1)[valid].ravel())
        offsets.append(np.linalg.norm(error[:, None, :, 0] - error[:, :, None, 1], axis=-1)[linked])
    named = {"lane ends": ends, "offsets of linked ends": offsets}
    return {name: np.quantile(np.concatenate(parts), (0.5, 0.9)).tolist() for name, parts in named.items()}
