"""Every objective at the smallest size that still runs all its parts.

On the command line: --config=tests/factories/small_runs.py:autoencoder
"""

from __future__ import annotations

import dataclasses

from scjax.train.configs import autoencoder, counts, denoiser
from tests.factories.worlds import AUTOENCODER, DENOISER


def get_config(objective: str = "autoencoder"):
    """Nine steps, a checkpoint every third."""
    config = {"autoencoder": autoencoder, "denoiser": denoiser, "counts": counts}[objective].get_config("tiny")
    config.model = {"width": 8, "queries": 2, "heads": 2}
    if objective == "autoencoder":
        config.model = dataclasses.asdict(AUTOENCODER)
    if objective == "denoiser":
        config.model = denoiser.size_fields(DENOISER)
        config.position_head_fit = {"batches": 4, "steps": 40}
    config.batch.batch_size = 2
    config.batch.buckets = ((52, 64),)
    config.steps = 9
    config.optimizer.warmup = 2
    config.log_every = config.checkpoint_every = 3
    config.evaluate_every = config.picture_every = 9
    config.tensorboard = False
    return config
