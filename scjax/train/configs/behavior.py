"""How agents move: the network of ``LearnedBehavior``, from logs with motion.

    scjax data logs runs/logs --worlds 200
    scjax train --config=behavior --workdir=runs/behavior --config.logs=runs/logs --config.cache=runs/motion

Expected on 300 logs of synthetic worlds after 5,000 steps of 32: motion 3.60 and nll 3.08 on held-back places (3.83 and
3.41 after 500 steps). A step takes 50 ms of one CPU core.

Logs are files of any format with motion at 10 or 5 Hz. The cache holds them as arrays and is built at the first start.
"""

from __future__ import annotations

import ml_collections

VARIANTS = {"tiny": (8, 200), "small": (48, 12000)}  # batch, steps


def get_config(variant: str = "small") -> ml_collections.ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(f"--config=behavior:{variant:.80} is an unknown variant: choose one of {', '.join(VARIANTS)}")
    batch_size, steps = VARIANTS[variant]
    config = ml_collections.ConfigDict()
    config.objective = "behavior"
    config.logs = "runs/logs"
    config.cache = "runs/motion"
    config.rolls = 2  # of each log; all but the first stray from the tracks and return
    config.init_from = ""  # folder of a behavior to train on from, or "shipped"
    config.seed = 0
    config.sharding = "flat"  # vectors in equal shares over devices; or "fsdp": arrays by rules (nn/sharding.py)
    config.steps = steps
    config.model = {
        "width": 64,
        "layers": 2,
        "heads": 4,
        "neighbors": 12,
        "history": 5,  # motions of 0.2 s
        "motions": 256,  # tokens of a class
        "returns": 8,
    }
    config.batch = {
        "batch_size": batch_size,
        "agents": 64,
        "trained": 12,  # agents of each moment
        "unknown_past": 0.15,  # share of moments as at the start of a roll-out
        "seed": 0,
    }
    config.optimizer = {
        "kind": "adamw",  # or "muon"
        "learning_rate": 1e-3,
        "warmup": 200,
        "schedule": "linear",
        "weight_decay": 1e-4,
        "clip": 1.0,
    }
    config.return_weight = 0.2
    config.ema_decay = 0.999
    config.log_every = 100
    config.evaluate_every = max(steps // 10, 1)
    config.picture_every = 0
    config.checkpoint_every = max(min(steps // 10, 1000), 1)
    config.export_at = ()
    config.tensorboard = False
    return config
