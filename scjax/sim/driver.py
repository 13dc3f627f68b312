"""The intelligent driver model, and how drivers differ.

Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic simulations", Phys.
Rev. E 62 (2000), eqs. 1-3.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Float

from scjax.scene.scene import AnyArray


@dataclasses.dataclass(frozen=True)
class DriverSettings:
    """How drivers drive; defaults near those of nuPlan's reactive agents.

    Attributes:
      time_headway: to the vehicle ahead [s].
      min_gap: to it when both stand [m].
      acceleration, deceleration: comfortable ones [m/s^2].
      max_deceleration: in emergencies [m/s^2].
      speed_factor: mean of the desired speeds, relative to those of the road.
      speed_deviation: standard deviation of this factor between drivers.
      yields: drivers give way where lanes cross or merge.
      stops_at_red: drivers obey signals.
    """

    time_headway: float = 1.5
    min_gap: float = 1.5
    acceleration: float = 1.5
    deceleration: float = 2.0
    max_deceleration: float = 7.0
    speed_factor: float = 1.0
    speed_deviation: float = 0.1
    yields: bool = True
    stops_at_red: bool = True

    def __post_init__(self):
        for name in ("time_headway", "min_gap", "acceleration", "deceleration", "max_deceleration", "speed_factor"):
            if not 0 < getattr(self, name) < 100:
                raise ValueError(f"{name} is {getattr(self, name)}: give a number above 0 and below 100")
        if not 0 <= self.speed_deviation < 1:
            raise ValueError(f"speed_deviation is {self.speed_deviation}: give a number from 0 to below 1")


NORMAL = DriverSettings()
"""Drivers near those of nuPlan's reactive agents."""
CALM = DriverSettings(time_headway=2.2, min_gap=2.5, acceleration=1.0, deceleration=1.5, speed_factor=0.85)
"""Careful drivers who keep their distance."""
ADVERSARIAL = DriverSettings(
    time_headway=0.6, min_gap=0.8, acceleration=2.5, deceleration=3.5, speed_factor=1.25, yields=False
)
"""Drivers who speed, tailgate and do not give way; they still stop at red and brake for who is in front of them."""


def idm_acceleration(
    settings: DriverSettings,
    speed: Float[AnyArray, "*shape"],
    limit: Float[AnyArray, "*shape"],
    gap: Float[AnyArray, "*shape"],
    lead_speed: Float[AnyArray, "*shape"],
) -> Float[AnyArray, "*shape"]:
    """Acceleration [m/s^2] at ``speed`` with a desired speed ``limit`` [m/s] behind a leader.

    Args:
      gap: from bumper to bumper, infinite without a leader [m].
      lead_speed: of the leader [m/s].
    """
    braking = 2 * (settings.acceleration * settings.deceleration) ** 0.5
    dynamic = speed * settings.time_headway + speed * (speed - lead_speed) / braking
    desired = settings.min_gap + jnp.maximum(dynamic, 0.0)
    ratio = desired / jnp.maximum(gap, 0.1)
    free = 1.0 - (speed / jnp.maximum(limit, 0.1)) ** 4
    acceleration = settings.acceleration * (free - ratio * ratio)
    return jnp.clip(acceleration, -settings.max_deceleration, settings.acceleration)
