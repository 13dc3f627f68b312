"""Stage 4, the decoder trained on with noised latents, so that parts of samples fit together; any time after 1.

    python -m experiments.train --config=experiments/configs/decoder.py:small --workdir=runs/decoder \
        --config.records=runs/records --config.start=runs/text/model

Latents stay what they are: the denoiser and the counts of ``start`` join the exported model as they were.
Expected numbers of recorded runs: experiments/results/.
"""

from __future__ import annotations

import ml_collections

from experiments.configs import autoencoder

VARIANTS = {"tiny": (16, 300, 1e-3), "small": (32, 3000, 5e-4), "base": (64, 20_000, 2e-4)}  # batch, steps, rate


def get_config(variant: str = "small") -> ml_collections.ConfigDict:
    """The config of a variant; every field can be changed with --config.FIELD=VALUE."""
    if variant not in VARIANTS:
        raise ValueError(f"unknown variant {variant!r} of decoder.py: choose one of {', '.join(VARIANTS)}")
    batch_size, steps, learning_rate = VARIANTS[variant]
    like = autoencoder.get_config(variant)
    config = ml_collections.ConfigDict()
    config.stage = "decoder"
    config.records = "runs/records"
    config.start = "runs/text/model"  # model folder with the autoencoder, whatever else it holds
    config.seed = 0
    config.steps = steps
    config.batch = {**like.batch, "batch_size": batch_size}
    config.optimiser = {**like.optimiser, "learning_rate": learning_rate, "warmup": min(200, steps // 10)}
    config.ema_decay = 0.998
    # Each scene draws its own noise level from a half normal of this width, in units of the latents' spread.
    config.loss = {**like.loss, "latent_noise": 0.2}
    config.log_every = 50
    config.evaluate_every = max(steps // 3, 1)
    config.picture_every = max(steps // 3, 1)  # 0: never, as above
    config.checkpoint_every = max(min(steps // 10, 500), 1)
    config.export_at = ()  # steps whose model is kept as WORKDIR/model-<step>
    config.tensorboard = True
    return config
