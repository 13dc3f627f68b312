"""The study of conditioning mechanisms (attention-variants.md): which ones, on what, how long, how judged.

    python -m experiments.studies.ablation --config=experiments/studies/ablation/config.py --workdir=runs/ablation \
        --config.records=runs/records --config.autoencoder=runs/autoencoder/model

All runs start from one unconditional base and train all weights, ``none`` too: what a mechanism adds is then
not what more steps add, and few steps suffice. (--config.training.freeze=True is the paper's regime, in which only the
mechanism learns; ``none`` is the base itself then.) recipe: ways to train cross-global on texts instead: how often
conditions are dropped, and the base frozen. smoke: a handful of steps, to see that everything runs.
"""

from __future__ import annotations

import ml_collections

from experiments.studies.ablation.entries import KINDS, MECHANISMS, RECIPES
from scjax.train.configs import denoiser

VARIANTS = ("standard", "recipe", "smoke")
_ENTRIES = {"standard": tuple(MECHANISMS), "recipe": tuple(RECIPES), "smoke": ("none", "full")}


def get_config(variant: str = "standard") -> ml_collections.ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(f"unknown variant {variant!r} of ablation.py: choose one of {', '.join(VARIANTS)}")
    smoke = variant == "smoke"
    config = ml_collections.ConfigDict()
    config.records = "runs/records"  # captioned and embedded for kind text
    config.autoencoder = "runs/autoencoder/model"  # model folder of stage 1
    # Model folder of an unconditional denoiser of training's sizes; "": trained first, with the first of the seeds.
    config.base = ""
    config.base_steps = 2 if smoke else 6_000
    config.kinds = KINDS if variant == "standard" else ("text",)
    config.entries = _ENTRIES[variant]
    config.seeds = (0,) if smoke else (0, 1, 2)  # of new weights, data order, noise and samples
    config.more = ()  # ablation.json files of other seeds or kinds, perhaps of other machines, to report as well
    config.samples = 4 if smoke else 250  # held-back records; those that fit the buckets below are what runs are asked
    config.sampler = "dpm++"
    config.sampler_steps = 2 if smoke else 10
    config.guidance = 4.0

    training = denoiser.get_config("tiny")  # of every run; records, autoencoder, condition and control are set by it
    training.steps = 3 if smoke else 1_600  # 600 teach nobody anything
    # Compiling takes a good part of a short run. What lies farthest off is left out, in a fifth of our worlds.
    training.batch.buckets = ((61, 100),) if smoke else ((16, 28),)
    training.optimizer.warmup = 1 if smoke else 100
    training.optimizer.learning_rate = 1e-3  # at twice as much, a text is read later and the base forgets more
    training.evaluate_every = training.picture_every = 0
    training.log_every = 1 if smoke else 50
    training.checkpoint_every = 3 if smoke else 250
    training.tensorboard = False
    if smoke:
        training.batch.batch_size = 2
    config.training = training
    return config
