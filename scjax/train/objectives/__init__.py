"""What can be trained: name of ``config.objective`` -> its class, made by ``from_config``."""

from scjax.train.objectives.autoencoder import AutoencoderObjective
from scjax.train.objectives.base import Objective
from scjax.train.objectives.behavior import BehaviorObjective
from scjax.train.objectives.counts import CountObjective
from scjax.train.objectives.denoiser import DenoiserObjective
from scjax.train.objectives.vision import VisionObjective

OBJECTIVES = {
    "autoencoder": AutoencoderObjective,
    "denoiser": DenoiserObjective,
    "counts": CountObjective,
    "behavior": BehaviorObjective,
    "vision": VisionObjective,
}


def make_objective(config) -> Objective:
    """The objective that ``config`` describes; reads its records and models.

    Raises:
      ValueError: unknown ``config.objective``, or an option or file that does not fit.
    """
    if config.objective not in OBJECTIVES:
        raise ValueError(f"config.objective is {config.objective!r}: choose one of {', '.join(OBJECTIVES)}")
    return OBJECTIVES[config.objective].from_config(config)
