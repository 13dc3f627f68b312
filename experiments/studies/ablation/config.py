"""Config of the ablation of conditioning mechanisms (attention-variants.md).

    python -m experiments.studies.ablation --config=experiments/studies/ablation/config.py --workdir=runs/ablation \
        --config.records=runs/records --config.autoencoder=runs/autoencoder/model

All runs start from one unconditional base and train all weights, also the entry ``none``; so gains do not come from
more steps. (--config.training.freeze=True is the regime of the paper, in which only the mechanism learns.)

standard: all mechanisms on texts and images. pictures: the ten mechanisms on rendered pictures, with the features of
--config.training.images=runs/road (scjax data dashcam, then embed-images, then the module road_features beside this
file), from a short base, on windows that are encoded once. recipe: ways to train cross-global on texts (condition
dropout, frozen base). smoke: a few steps, to check that everything runs.
"""

from __future__ import annotations

import ml_collections

from experiments.studies.ablation.entries import MECHANISMS, MODALITIES, RECIPES
from scjax.nn.cross_attention import OPTIONS
from scjax.train.configs import denoiser

VARIANTS = ("standard", "pictures", "recipe", "smoke")
_ENTRIES = {
    "standard": tuple(MECHANISMS),
    "pictures": tuple(OPTIONS),
    "recipe": tuple(RECIPES),
    "smoke": ("none", "full"),
}


def get_config(variant: str = "standard") -> ml_collections.ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(f"unknown variant {variant!r} of the ablation: choose one of {', '.join(VARIANTS)}")
    smoke, pictures = variant == "smoke", variant == "pictures"
    config = ml_collections.ConfigDict()
    config.records = "runs/records"  # captioned and embedded for texts
    config.autoencoder = "runs/autoencoder/model"  # model folder of stage 1
    # Model folder of an unconditional denoiser with the sizes of training; "": train it first, with the first seed.
    config.base = ""
    config.base_steps = 2 if smoke else 2_500 if pictures else 6_000
    config.modalities = MODALITIES if variant == "standard" else ("image",) if pictures else ("text",)
    config.entries = _ENTRIES[variant]
    config.seeds = (0,) if smoke else (0, 1, 2)  # of initialization, data order, noise and samples
    config.more = ()  # ablation.json files with further seeds or modalities for the report
    config.out = ""  # path of the report without ending; "": WORKDIR/ablation
    config.samples = 4 if smoke else 250  # held-out records; those within the buckets below are used
    config.fixed_scenes = pictures  # windows and pictures are the same in every epoch, and encoded once
    config.sampler = "dpm++"
    config.sampler_steps = 2 if smoke else 10
    config.guidance = 4.0

    training = denoiser.get_config(
        "tiny"
    )  # of every run; records, autoencoder, condition and mechanism are set per run
    # 600 steps of 16 scenes are too few to learn captions. With pictures full attention follows after 600 of 8 already.
    training.steps = 3 if smoke else 600 if pictures else 1_600
    # One small bucket saves compilation; it drops the farthest elements in a fifth of the synthetic worlds.
    training.batch.buckets = ((61, 100),) if smoke else ((16, 28),)
    training.batch.batch_size = 2 if smoke else 8 if pictures else 16
    training.optimizer.warmup = 1 if smoke else 50 if pictures else 100
    training.optimizer.learning_rate = 1e-3  # at twice the rate, texts are learned later and the base is forgotten more
    training.evaluate_every = training.picture_every = 0
    training.log_every = 1 if smoke else 50
    training.checkpoint_every = 3 if smoke else 400 if pictures else 250
    training.tensorboard = False
    training.image_depth = not pictures  # features of the network that ships say how far things are
    if pictures:
        training.cross_attention_options.windowed.window = 18  # of 8 x 14 cells: windows hold a third of the keys
        training.batch.buckets = ((16, 16),)  # holds half of the forward windows; others lose the farthest elements
        training.batch.jitter_position = training.batch.jitter_heading = 0.0
        training.loss.known_lanes_share = training.loss.known_region_share = 0.0
    config.training = training
    return config
