"""Synthetic records and a tiny untrained model, made once a test session."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import jax
import numpy as np

from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.generate.model import Component, Model
from scjax.models import codec as codec
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.model import autoencoder
from scjax.models.counts.prior import count_table
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.models.latents import LatentStatistics
from scjax.synthetic.source import Worlds

# One block each: these tests are about what surrounds the networks, and compiling is what takes their time.
AUTOENCODER = AutoencoderConfig.preset(
    "tiny",
    lane_width=8,
    lane_heads=2,
    lane_ff=8,
    agent_width=8,
    agent_heads=2,
    agent_ff=8,
    edge_width=4,
    encoder_blocks=1,
    decoder_blocks=1,
)
DENOISER = DenoiserConfig.preset("tiny", lane_width=8, lane_heads=2, agent_width=8, agent_heads=2, blocks=1, domains=2)


def make_records(folder: Path) -> None:
    """A record folder of synthetic worlds, with both splits."""
    build_records(Worlds(0, 4), folder, BuildOptions(split_percent=34.0))


@functools.cache
def tiny_model(condition=None, *, seed: int = 0, **changes) -> Model:
    """Random parameters, of the denoiser drawn from ``seed``; the count table knows two domains."""
    config = dataclasses.replace(DENOISER, condition=condition, **changes)
    rows = [(0, 0, 3, 2), (0, 0, 4, 3), (1, 0, 6, 5), (1, 2, 5, 4)]
    return Model(
        components={
            "autoencoder": Component(AUTOENCODER, jax.device_get(autoencoder(AUTOENCODER).init(jax.random.key(1)))),
            "denoiser": Component(config, _stirred(denoiser(config).shapes(), seed)),
        },
        codec=codec.scjax(),
        latents=LatentStatistics.identity(),
        domains=("here", "there"),
        counts=count_table(rows, 2),
    )


def _stirred(shapes, seed: int):
    """Every leaf random: fresh adaLN and output layers are zero, and a network of zeros would hide mistakes."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda leaf: rng.normal(0, 0.2, leaf.shape).astype(np.float32), shapes)
