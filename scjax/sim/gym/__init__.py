"""Driving as Gymnasium environments, one at a time or many in one program; needs the extra ``gym``."""

try:
    import gymnasium as _gymnasium  # noqa: F401
except ImportError as error:
    raise ImportError("driving environments need Gymnasium: pip install 'scjax[gym]'") from error

from scjax.sim.gym.rewards import Endings, RewardWeights
from scjax.sim.gym.single import DrivingEnv
from scjax.sim.gym.vector import DrivingVectorEnv

__all__ = ["DrivingEnv", "DrivingVectorEnv", "Endings", "RewardWeights"]
