"""Every stage at the smallest size that still runs every part: --config=tests/factories/small_runs.py:autoencoder"""

from __future__ import annotations

import dataclasses

from scjax.train.configs import autoencoder, denoiser
from scjax.train.configs import counts as counter
from tests.factories.worlds import AUTOENCODER, DENOISER


def get_config(stage: str = "autoencoder"):
    """Nine steps, a checkpoint every third."""
    config = {"autoencoder": autoencoder, "denoiser": denoiser, "counter": counter}[stage].get_config("tiny")
    sizes = {"autoencoder": AUTOENCODER, "denoiser": DENOISER}
    config.model = {"width": 8, "queries": 2, "heads": 2}
    if stage in sizes:
        config.model = {k: v for k, v in dataclasses.asdict(sizes[stage]).items() if k != "cross_attention"}
    config.batch.batch_size = 2
    config.batch.buckets = ((52, 64),)
    config.steps = 9
    config.optimizer.warmup = 2
    config.log_every = config.checkpoint_every = 3
    config.evaluate_every = config.picture_every = 9
    config.tensorboard = False
    return config
