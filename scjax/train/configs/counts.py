"""Lane and agent counts from a caption or from a request for attributes (f_count).

    scjax train --config=counts:small --workdir=runs/counts --config.records=runs/records \
        --config.denoiser=runs/text/model

"text" needs captioned and embedded records, "attributes" measured ones (scjax data attributes).
Expected with captions on the synthetic world, 3,000 steps, four minutes on two cores: mean absolute error 3.37 lanes
and 2.58 agents, -log P of the true pair 4.64 on 766 held-back ones.
"""

from __future__ import annotations

import ml_collections

VARIANTS = {"tiny": (32, 300), "small": (64, 4000)}  # batch, steps


def get_config(variant: str = "small") -> ml_collections.ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(f"--config=counts:{variant:.80} is an unknown variant: choose one of {', '.join(VARIANTS)}")
    batch_size, steps = VARIANTS[variant]
    config = ml_collections.ConfigDict()
    config.objective = "counts"
    config.condition = "text"  # or "attributes"
    config.records = "runs/records"
    config.denoiser = "runs/text/model"  # model folder that the network is added to
    config.seed = 0
    config.sharding = "flat"  # vectors in equal shares over devices; or "fsdp": arrays by rules (nn/sharding.py)
    config.steps = steps
    config.model = {"width": 128, "queries": 4, "heads": 4}
    config.batch = {
        "batch_size": batch_size,
        "buckets": ((61, 100),),  # (agent, lane) slots
        "crops": (1.0, 0.0, 0.0),  # captions and attributes describe centred windows
        "jitter_position": 0.5,  # m
        "jitter_heading": 2.0,  # degrees
        "order": "shuffle",
        "text_slots": 96,
        "seed": 0,
        "workers": 1,
    }
    config.optimizer = {
        "kind": "adamw",  # or "muon"
        "learning_rate": 1e-3,
        "warmup": 100,
        "schedule": "linear",
        "weight_decay": 1e-3,
        "clip": 10.0,
    }
    config.domain_dropout = 0.3  # share of examples without a domain
    config.ema_decay = 0.995
    config.log_every = 50
    config.evaluate_every = max(steps // 10, 1)
    config.picture_every = 0
    config.checkpoint_every = max(min(steps // 10, 1000), 1)
    config.export_at = ()
    config.tensorboard = True
    return config
