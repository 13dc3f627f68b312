"""Inputs and the smallest config of an ablation."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ml_collections import ConfigDict

import scjax
from experiments.studies.ablation.config import get_config
from tests.factories.worlds import AUTOENCODER, DENOISER, tiny_model


def save_inputs(folder: Path, records: Path) -> Path:
    """Captioned records, of two held-out locations or more, and an autoencoder."""
    (folder / "records").symlink_to(records)
    assert AUTOENCODER.lane_latent == DENOISER.lane_latent
    scjax.save(tiny_model().without("denoiser"), folder / "autoencoder")
    return folder


def smoke_config(folder: Path) -> ConfigDict:
    """Three steps per run, with a learning rate at which three steps change the model.

    Three scenes a batch stay on one of two devices: to spread a step takes a fifth more of its compiler.
    """
    config = get_config("smoke")
    config.training.batch.batch_size = 3
    config.records, config.autoencoder = str(folder / "records"), str(folder / "autoencoder")
    config.training.optimizer.learning_rate, config.training.ema_decay = 0.05, 0.5
    sizes = dataclasses.asdict(DENOISER)
    config.training.model.update({name: sizes[name] for name in ("lane_width", "agent_width", "lane_heads", "blocks")})
    return config
