"""Samplers by name, what each fits, and which one is taken where nothing is said.

The defaults have one place, here: ``DEFAULT_SAMPLER`` and ``DEFAULT_STEPS``. ``python -m experiments.studies.samplers`` measures what
they should be for a model.
"""

from __future__ import annotations

from scjax.diffusion.flow import FlowSchedule, flow_schedule
from scjax.diffusion.samplers.base import Sampler
from scjax.diffusion.samplers.ddim import DDIM
from scjax.diffusion.samplers.ddpm import DDPM
from scjax.diffusion.samplers.dpm_solver import DPMSolver
from scjax.diffusion.samplers.flow import Euler, Heun
from scjax.diffusion.samplers.threshold import Threshold
from scjax.diffusion.schedule import OFFICIAL_STEPS, Schedule, cosine_schedule, respaced
from scjax.models.denoiser.config import Prediction

__all__ = [
    "DDIM",
    "DDPM",
    "DEFAULT_SAMPLER",
    "DEFAULT_STEPS",
    "SAMPLERS",
    "DPMSolver",
    "Euler",
    "Heun",
    "Sampler",
    "Threshold",
    "sampler_of",
    "schedule_of",
]  # fmt: skip

SAMPLERS: dict[str, Sampler] = {one.name: one for one in (DDPM(), DDIM(), DPMSolver(), Euler(), Heun())}
DEFAULT_SAMPLER: dict[Prediction, str] = {"noise": "ddpm", "velocity": "ddpm", "flow": "heun"}
LEAST_SIGNAL = 0.03
"""Of the noisiest time at which a network is asked for the noise in fewer than all steps: the last two of 100 are left
out. At the last one abar is 2.4e-7, and x_0 = (x - noise eps) / signal takes an error of eps 2029 times; here 32 times,
and of x_0 the start lacks 0.03. Networks of the other predictions divide by nothing and are asked at all times."""
DEFAULT_STEPS: dict[Prediction, dict[str, int]] = {
    "noise": {"ddpm": OFFICIAL_STEPS, "ddim": 50, "dpm++": 25},
    "velocity": {"ddpm": 25, "ddim": 50, "dpm++": 25},
    "flow": {"dpm++": 25, "euler": 50, "heun": 25},
}
"""By default. Ancestral sampling of the velocity: the fewest that 192 scenes of the model that ships cannot tell from
100 (recorded in experiments/results/samplers); of the noise: all of training, as the release. The others were not
chosen by measurement."""


def sampler_of(chosen: str | Sampler | None, prediction: Prediction) -> Sampler:
    """The sampler of a name, or the default for what the network estimates.

    Raises:
      ValueError: no such name, or a sampler that does not fit; names those that do.
    """
    fitting = ", ".join(name for name, one in SAMPLERS.items() if prediction in one.predictions)
    sampler = DEFAULT_SAMPLER[prediction] if chosen is None else chosen
    if isinstance(sampler, str):
        if sampler not in SAMPLERS:
            raise ValueError(f"there is no sampler {sampler!r}: choose one of {fitting}")
        sampler = SAMPLERS[sampler]
    if prediction not in sampler.predictions:
        raise ValueError(
            f"the sampler {sampler.name!r} is for networks that estimate {' or '.join(sampler.predictions)}, and this "
            f"model's estimates {prediction}: choose one of {fitting}"
        )
    return sampler


def schedule_of(sampler: Sampler, prediction: Prediction, steps: int | None = None) -> Schedule | FlowSchedule:
    """The levels that a sampler visits (``trailing_timesteps``); by default ``DEFAULT_STEPS`` of them.

    Raises:
      ValueError: if ``steps`` is not in 2..100.
    """
    steps = DEFAULT_STEPS[prediction][sampler.name] if steps is None else steps
    if prediction == "flow":
        return flow_schedule(steps, last=sampler.last)
    least = LEAST_SIGNAL if prediction == "noise" else 0.0
    return respaced(cosine_schedule(), steps, sampler.last, least)
