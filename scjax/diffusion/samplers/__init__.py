"""Samplers by name. A new sampler is one file and one entry of ``SAMPLERS``.

``scjax.diffusion.defaults`` names the default samplers. ``python -m experiments.studies.samplers`` measures which
sampler and number of steps suit a model.
"""

from __future__ import annotations

from scjax.diffusion.defaults import DEFAULT_SAMPLER, MIN_NOISE_PREDICTION_ALPHA
from scjax.diffusion.flow import FlowSchedule, flow_schedule
from scjax.diffusion.log_snr_schedule import log_snr_schedule
from scjax.diffusion.samplers.base import Sampler as Sampler
from scjax.diffusion.samplers.ddim import DDIM
from scjax.diffusion.samplers.ddpm import DDPM
from scjax.diffusion.samplers.dpm_solver import DPMSolver
from scjax.diffusion.samplers.flow import Euler, Heun
from scjax.diffusion.samplers.threshold import Threshold as Threshold
from scjax.diffusion.schedule import DiffusionSchedule, cosine_schedule, respace
from scjax.models.denoiser.config import Prediction, Schedule

SAMPLERS: dict[str, Sampler] = {sampler.name: sampler for sampler in (DDPM(), DDIM(), DPMSolver(), Euler(), Heun())}

DEFAULT_STEPS: dict[Prediction, dict[str, int]] = {
    prediction: {
        name: sampler.default_steps[prediction]
        for name, sampler in SAMPLERS.items()
        if prediction in sampler.default_steps
    }
    for prediction in DEFAULT_SAMPLER
}
"""Network prediction -> name of a suitable sampler -> its default number of steps."""


def resolve_sampler(sampler: str | Sampler | None, prediction: Prediction) -> Sampler:
    """The sampler of a name, or the default sampler for what the network predicts.

    Args:
      sampler: name of ``SAMPLERS``, a sampler with options of its own, or None.

    Raises:
      ValueError: if the name is unknown or the sampler does not suit the prediction; lists those that do.
    """
    suitable = ", ".join(DEFAULT_STEPS[prediction])
    choice = DEFAULT_SAMPLER[prediction] if sampler is None else sampler
    if isinstance(choice, str):
        if choice not in SAMPLERS:
            raise ValueError(f"there is no sampler {choice!r}: choose one of {suitable}")
        choice = SAMPLERS[choice]
    if not isinstance(choice, Sampler):
        raise ValueError(f"the sampler must be a name or a scjax.samplers.Sampler, not {type(choice).__name__}")
    if prediction not in choice.default_steps:
        raise ValueError(
            f"the sampler {choice.name!r} is for networks that estimate {' or '.join(choice.default_steps)}, and this "
            f"model's estimates {prediction}: choose one of {suitable}"
        )
    return choice


def make_schedule(
    sampler: Sampler, prediction: Prediction, steps: int | None = None, schedule: Schedule = "cosine"
) -> DiffusionSchedule | FlowSchedule:
    """The noise levels that a sampler visits (``trailing_timesteps``).

    Args:
      steps: number of steps; None: ``sampler.default_steps[prediction]``.
      schedule: that of the training (``DenoiserConfig.schedule``).

    Raises:
      ValueError: if ``steps`` is not in 2..100.
    """
    steps = sampler.default_steps[prediction] if steps is None else steps
    if prediction == "flow":
        return flow_schedule(steps, last_step=sampler.last_step)
    if schedule == "log_snr":
        return log_snr_schedule(steps, last_step=sampler.last_step)
    min_alpha = MIN_NOISE_PREDICTION_ALPHA if prediction == "noise" else 0.0
    return respace(cosine_schedule(), steps, sampler.last_step, min_alpha)
