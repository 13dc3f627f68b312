"""Intelligent driver model.

Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic simulations", Phys.
Rev. E 62 (2000), eqs. 1-3.
"""

from __future__ import annotations

import numpy as np

ACCELERATION, DECELERATION = 1.5, 2.0  # m/s^2
MAX_DECELERATION = 6.0  # m/s^2
TIME_HEADWAY, MIN_GAP = 1.3, 2.0  # s, m


def accelerate(
    speed: np.ndarray,
    limit: np.ndarray,
    gap: np.ndarray,
    closing_speed: np.ndarray,
    time_headway: np.ndarray | float = TIME_HEADWAY,
    min_gap: np.ndarray | float = MIN_GAP,
) -> np.ndarray:
    """Accelerations [m/s^2]; where ``gap`` has more dimensions than ``speed``, the first one counts obstacles.

    Args:
      speed, limit: present and desired speeds [m/s].
      gap: to the vehicle or line ahead, infinite without one [m].
      closing_speed: at which the gap shrinks [m/s].
    """
    desired = min_gap + np.maximum(
        0.0, speed * time_headway + speed * closing_speed / (2 * np.sqrt(ACCELERATION * DECELERATION))
    )
    interaction = (desired / np.maximum(gap, 0.1)) ** 2
    if interaction.ndim > speed.ndim:
        interaction = interaction.max(0)
    acceleration = ACCELERATION * (1 - (speed / limit) ** 4 - interaction)
    return np.clip(acceleration, -MAX_DECELERATION, ACCELERATION)
