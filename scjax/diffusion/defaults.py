"""Default values of training and sampling.

Each sampler declares its own default number of steps (``default_steps`` in its file): a new sampler is one file and one
entry of ``samplers.SAMPLERS``.
"""

from __future__ import annotations

from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType

NUM_TRAIN_TIMESTEPS = 100
"""Timesteps of the cosine schedule, as in the official release."""

DEFAULT_SAMPLER: dict[Prediction, str] = {"noise": "ddpm", "velocity": "ddpm", "flow": "heun"}
"""Network prediction -> name of its default sampler."""

DEFAULT_GUIDANCE_SCALE = 2.0
"""Guidance scale of conditional models; unconditional models use 1 (no guidance)."""

DEFAULT_TEMPERATURE = PerType(agents=1.0, lanes=0.75)
"""Scale of the sampling noise per type, as in the official release."""

DEFAULT_LATENT_BOUND = 5.0
"""Bound on normalized latents [standard deviations]: clips the state, as in the official release, and x0 estimates."""

DEFAULT_ENERGIES: tuple[tuple[str, float], ...] = (("connections", 1.0), ("overlap", 1.0), ("off_lane", 0.5))
"""(name, weight) of the energies of ``EnergyGuidance``. Overlaps outweigh off-lane distances: of two vehicles at one
place of a lane, one has to leave the lane first."""

MIN_NOISE_PREDICTION_ALPHA = 0.03
"""Smallest alpha at which a noise-predicting network is evaluated, if it samples in fewer than all steps.

This leaves out the last two of 100 timesteps. At the last one, alphas_cumprod is 2.4e-7: x0 = (x - sigma eps) / alpha
multiplies an error of eps by 2029. At alpha 0.03 it multiplies by 32, and the start lacks only 0.03 x0. Other
predictions need no division and use all timesteps."""

MAX_PRECOMPUTED = 2**25
"""Largest number of precomputed modulation values per device: 128 MiB in float32."""

LANE_LOSS_WEIGHT = 10.0
"""Weight of the lanes relative to the agents in the training loss, as in the official release."""

DEFAULT_LABEL_DROPOUT = DEFAULT_CONDITION_DROPOUT = 0.1
"""Share of training scenes whose label or condition is dropped, for classifier-free guidance."""
