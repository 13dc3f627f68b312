"""The vision network that comes with scjax, from rendered dashcam pictures of synthetic worlds.

    scjax data synthetic runs/records --worlds 1800 --seed 501
    scjax data dashcam runs/records runs/pictures
    scjax train --config=vision:small --workdir=runs/vision --config.pictures=runs/pictures

Expected of 4,500 steps on 15,662 pictures that begin with a trained network, 38 minutes on two cores beside other work:
of held-back pictures 95 % of the cells have the right class, and 93 % of the cells of objects up to 40 m are found,
their places 1.1 m off (means of medians of batches).
"""

from __future__ import annotations

import dataclasses

import ml_collections

from scjax.encoders.dashcam_network import DashcamConfig

VARIANTS = {"tiny": (4, 50), "small": (16, 2500)}  # batch, steps


def get_config(variant: str = "small") -> ml_collections.ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(f"--config=vision:{variant:.80} is an unknown variant: choose one of {', '.join(VARIANTS)}")
    batch_size, steps = VARIANTS[variant]
    config = ml_collections.ConfigDict()
    config.objective = "vision"
    config.pictures = "runs/pictures"  # folder written by scjax data dashcam
    config.init_from = ""  # folder of a vision network to train on from
    config.seed = 0
    config.sharding = "flat"  # vectors in equal shares over devices; or "fsdp": arrays by rules (nn/sharding.py)
    config.steps = steps
    config.model = dataclasses.asdict(DashcamConfig(compute="auto"))
    config.batch = {
        "batch_size": batch_size,
        "mirror": 0.5,  # share of mirrored pictures
        "brightness": 0.2,  # standard deviation of the logarithm of a picture's gain
        "tint": 0.05,  # and of those of its channels
        "cut": 0.3,  # share of pictures of which only a part is seen
        "seed": 0,
    }
    config.optimizer = {
        "kind": "adamw",  # or "muon"
        "learning_rate": 1.5e-3,
        "warmup": 100,
        "schedule": "linear",
        "weight_decay": 1e-3,
        "clip": 5.0,
    }
    config.loss = {"classes": 1.0, "depth": 1.0, "objects": 2.0, "lanes": 1.0}  # weights
    config.ema_decay = 0.998
    config.log_every = 50
    config.evaluate_every = max(steps // 10, 1)
    config.picture_every = 0
    config.checkpoint_every = max(min(steps // 10, 1000), 1)
    config.export_at = ()
    config.tensorboard = False
    return config
