"""The vectorized autoencoder (official-spec §2).

    python -m scjax.data build SCENES runs/records
    scjax train --config=autoencoder:small --workdir=runs/autoencoder --config.records=runs/records

tiny: minutes on two cores, for tests and the README. small: an hour on two cores. base, official: GPUs; ``official``
is the released architecture and recipe on its own types (official-spec §2.6).

Expected of small on 276 recorded scenes, from the shipped autoencoder, 5,000 steps of 16 with Muon, two cores of an
AMD EPYC with AVX2, 43 minutes without compiling: lane points 0.151 m, agent centers 0.228 m, headings 0.29 degrees on
held-back tiles (recorded run of commit f19532b).
"""

from __future__ import annotations

import dataclasses

import ml_collections

from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.loss import OFFICIAL_WEIGHTS

VARIANTS = {
    #            batch  steps    learning rate
    "tiny": (16, 700, 2e-3),
    "small": (32, 30_000, 1e-3),
    "base": (64, 200_000, 3e-4),
    "official": (128, 357_450, 1e-4),
}


def get_config(variant: str = "small") -> ml_collections.ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(
            f"--config=autoencoder:{variant:.80} is an unknown variant: choose one of {', '.join(VARIANTS)}"
        )
    batch_size, steps, learning_rate = VARIANTS[variant]
    official = variant == "official"
    config = ml_collections.ConfigDict()
    config.objective = "autoencoder"
    config.records = "runs/records"  # folder written by python -m scjax.data build
    config.codec = "official_nuplan" if official else "scjax"
    config.init_from = ""  # model folder of an autoencoder to start from; "shipped": the package's
    config.seed = 0
    config.sharding = "flat"  # vectors in equal shares over devices; or "fsdp": arrays by rules (nn/sharding.py)
    config.steps = steps
    config.model = dataclasses.asdict(AutoencoderConfig.preset(variant, compute="auto"))
    config.batch = {
        "batch_size": batch_size,
        "buckets": ((12, 16), (16, 28), (32, 48), (61, 64), (61, 100)),  # (agent, lane) slots
        "crops": (1.0, 1.0, 1.0),  # centred, partitioned, forward
        "jitter_position": 0.0 if official else 2.0,  # m
        "jitter_heading": 0.0 if official else 10.0,  # degrees
        "order": "shuffle",
        "seed": 0,
        "workers": 1,
    }
    config.optimizer = {
        "kind": "adamw",  # or "muon": fewer steps, each somewhat slower
        "learning_rate": learning_rate,
        "warmup": 1000 if official else min(500, steps // 10),
        "schedule": "linear",  # to zero at the last step
        "weight_decay": 1e-4,
        "clip": 10.0,  # global gradient norm
    }
    config.ema_decay = 0.999
    config.loss = {
        # Against the same KL weight, agents weighted like lanes come back to decimetres instead of metres. Joints close
        # only once lanes are about right: a young network (tiny stays one) bends all ends towards each other instead.
        # The recorded runs weighed them from step 9,000 or 2,500 on. Steps keep decoded lanes from trembling.
        "weights": dataclasses.asdict(OFFICIAL_WEIGHTS)
        | (
            {}
            if official
            else {"agent_states": 10.0, "lane_connections": 0.0 if variant == "tiny" else 10.0, "lane_steps": 20.0}
        ),
        "balanced_links": not official,
        "official_lane_count": official,
        # Agents and lanes of a scene that weighs 1: in the total, coordinates of crowded scenes then weigh more, and
        # every element the same. (): every scene the same.
        "typical_counts": (),
    }
    config.log_every = 50
    config.evaluate_every = max(steps // 10, 1)
    config.picture_every = max(steps // 5, 1)  # 0: never, as above
    config.checkpoint_every = max(min(steps // 10, 1000), 1)
    config.export_at = ()  # steps whose model is written to WORKDIR/model-<step>
    config.tensorboard = True
    return config
