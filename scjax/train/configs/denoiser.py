"""The latent denoiser (official-spec §4-6) on a trained autoencoder.

    scjax train --config=denoiser:small --workdir=runs/denoiser --config.records=runs/records \
        --config.autoencoder=runs/autoencoder/model

Variants as in autoencoder.py.

Expected of small on 276 recorded scenes, 8,200 steps of 32, two cores of an AMD EPYC with AVX2, sampled at true counts
in 32 steps with 32 rounds of energy guidance: mean connection gap 0.24 m, 94 % of vehicles within 1.5 m of a lane, no
overlapping vehicles (recorded run of commit f19532b). On captions of the synthetic world, 13,000 steps from an earlier
model: 94 minutes on two cores with AVX-512, 95 scenes/s (docs/results/training.md).
"""

from __future__ import annotations

import dataclasses

import ml_collections

from scjax.models.denoiser.config import DenoiserConfig
from scjax.nn.cross_attention import OPTIONS

VARIANTS = {
    #            batch  steps    learning rate  EMA decay
    "tiny": (16, 900, 2e-3, 0.995),
    "small": (32, 60_000, 5e-4, 0.9995),
    "base": (64, 200_000, 2e-4, 0.9999),
    "official": (256, 500_000, 5e-5, 0.9999),
}


def size_fields(model: DenoiserConfig) -> dict:
    """All fields but those that follow from other options of the config."""
    apart = ("cross_attention", "attributes", "agent_kinds", "lane_kinds")
    return {name: value for name, value in dataclasses.asdict(model).items() if name not in apart}


def cross_attention_options() -> dict[str, dict]:
    """The default options of every conditioning mechanism that has any; ``config.cross_attention`` chooses."""
    options = {name: dataclasses.asdict(kind()) for name, kind in OPTIONS.items()}
    return {name: fields for name, fields in options.items() if fields}


def get_config(variant: str = "small") -> ml_collections.ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(f"--config=denoiser:{variant:.80} is an unknown variant: choose one of {', '.join(VARIANTS)}")
    batch_size, steps, learning_rate, ema_decay = VARIANTS[variant]
    official = variant == "official"
    config = ml_collections.ConfigDict()
    config.objective = "denoiser"
    config.records = "runs/records"  # folder written by python -m scjax.data build
    config.autoencoder = "runs/autoencoder/model"  # model folder of stage 1
    # Or "text": captions of the records, embedded by python -m scjax.data embed. Or "image": what a camera sees ahead
    # in forward windows; the other windows then go without.
    config.condition = "none"
    # Features of pictures named SPLIT-ROW for every record (scjax data dashcam, then embed-images); "": ray-cast
    # classes and depth (scjax.camera.raycast).
    config.images = ""
    config.image_depth = True  # whether depth is read beside the features
    # Whether kinds of lanes and agents are read as well, and requests for attributes, drawn from what
    # python -m scjax.data attributes has measured.
    config.attributes = False
    # Model folder of a denoiser to start from, e.g. the unconditional base of a text model; "shipped": the package's.
    config.init_from = ""
    config.freeze = False  # whether what it gives stays as it is, but for what reads texts or pictures
    config.seed = 0
    config.sharding = "flat"  # vectors in equal shares over devices; or "fsdp": arrays by rules (nn/sharding.py)
    config.steps = steps
    config.model = size_fields(DenoiserConfig.preset(variant, compute="auto"))
    config.cross_attention = (
        "cross_global"  # how scene tokens read the condition: a name of scjax.nn.cross_attention.OPTIONS
    )
    config.cross_attention_options = cross_attention_options()  # --config.cross_attention_options.windowed.window=16
    config.batch = {
        "batch_size": batch_size,
        "buckets": ((12, 16), (16, 28), (32, 48), (61, 64), (61, 100)),  # (agent, lane) slots
        "crops": (1.0, 1.0, 1.0) if official else (3.0, 1.0, 1.0),  # centred, partitioned, forward
        "jitter_position": 0.0 if official else 2.0,  # m
        "jitter_heading": 0.0 if official else 10.0,  # degrees
        "order": "recursive",
        "seed": 0,
        "text_slots": 96,  # tokens of a caption at most
        "workers": 1,
    }
    config.optimizer = {
        "kind": "adamw",  # or "muon" (scjax/train/muon.py)
        "learning_rate": learning_rate,
        "warmup": 500,
        "schedule": "constant" if official else "linear",  # linear: to zero at the last step
        "weight_decay": 1e-5,
        "clip": 10.0,  # global gradient norm
    }
    config.ema_decay = ema_decay
    config.loss = {
        "times": "uniform",  # or "logit-normal": mostly times in the middle
        "continuous_times": False,  # also between the timesteps; needs config.model.prediction=flow
        "label_dropout": 0.1,
        "condition_dropout": 0.1,
        "kind_dropout": 0.1,  # share of scenes without kinds of lanes, and of agents
        "known_lanes_share": 0.0 if official else 0.15,  # share of scenes all of whose lanes are known
        "known_region_share": 0.0 if official else 0.1,  # share of scenes whose elements beyond a random line are known
        "count_known": official,  # whether known tokens count in the loss mean
        "collision": 0.0,  # weight of the penalty of overlapping vehicles; the release: 0.064 a scene
        # Weights of errors in metres of the decoded estimate: joints of lanes, offsets of agents from their lane.
        "connections": 0.0,
        "lateral_offsets": 0.0,
    }
    # Only with config.model.relative_geometry: how long the position heads are fitted.
    config.position_head_fit = {"batches": 80, "steps": 4000}
    config.log_every = 50
    config.evaluate_every = max(steps // 20, 1)
    config.picture_every = max(steps // 5, 1)  # 0: never, as above
    config.checkpoint_every = max(min(steps // 10, 1000), 1)
    config.export_at = ()  # steps whose model is written to WORKDIR/model-<step>
    config.tensorboard = True
    return config
