"""What driving is worth, and what ends an episode; NumPy on the host."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float64

from scjax.scene.arguments import finite_number


@dataclasses.dataclass(frozen=True)
class RewardWeights:
    """Rewards and costs of one step; costs are positive numbers that are subtracted.

    Attributes:
      progress: reward for each meter along the route.
      collision: cost of a step in which the box overlaps another one.
      off_road: cost of a step more than 3 m from every centerline.
      red_light: cost of passing a stop line at red.
      comfort: cost for each second at 1 (m/s^2)^2, of acceleration and lateral acceleration.
      time: cost for each second.
    """

    progress: float = 0.1
    collision: float = 5.0
    off_road: float = 5.0
    red_light: float = 2.0
    comfort: float = 0.005
    time: float = 0.1

    def __post_init__(self):
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, finite_number(getattr(self, field.name), field.name, 0.0))

    def reward(self, terms: Mapping[str, np.ndarray], dt: float) -> Float64[np.ndarray, " B"]:
        """The reward of a step of B agents.

        Args:
          terms: fields of ``DrivingTerms``, ``acceleration`` and ``lateral_acceleration`` [m/s^2], each [B].
          dt: length of the step [s].
        """
        discomfort = np.square(terms["acceleration"], dtype=float)
        discomfort = discomfort + np.square(terms["lateral_acceleration"], dtype=float)
        return (
            self.progress * terms["progress"].astype(float)
            - self.collision * terms["collides"]
            - self.off_road * terms["off_road"]
            - self.red_light * terms["runs_red"]
            - self.comfort * discomfort * dt
            - self.time * dt
        )


@dataclasses.dataclass(frozen=True)
class Endings:
    """What terminates an episode, besides its time, which truncates it.

    Attributes:
      collision: the box of the driven agent overlaps another one.
      off_road: its center is more than 3 m from every centerline.
      arrival: it leaves the map at the end of its route.
      red_light: it passes a stop line at red.
    """

    collision: bool = True
    off_road: bool = True
    arrival: bool = True
    red_light: bool = False

    def terminated(self, terms: Mapping[str, np.ndarray]) -> Bool[np.ndarray, " B"]:
        """Whether a step with these terms, each [B], is the last one."""
        names = {"collision": "collides", "off_road": "off_road", "arrival": "arrives", "red_light": "runs_red"}
        return np.any([getattr(self, field) & terms[name] for field, name in names.items()], axis=0)
