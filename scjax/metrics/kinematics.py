"""Speeds and accelerations of trajectories by central differences, as in the Waymo Open Sim Agents Challenge."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from scjax.scene.angles import wrap_to_pi


class Kinematics(NamedTuple):
    """NaN where a value is not known: at the ends, and beside steps that are not valid.

    Attributes:
      speed: [m/s].
      acceleration: change of the speed, with its sign [m/s^2].
      angular_speed: change of the heading, with its sign [rad/s].
      angular_acceleration: change of the angular speed [rad/s^2].
    """

    speed: Float64[np.ndarray, "*objects steps"]
    acceleration: Float64[np.ndarray, "*objects steps"]
    angular_speed: Float64[np.ndarray, "*objects steps"]
    angular_acceleration: Float64[np.ndarray, "*objects steps"]


def kinematics(
    positions: Float64[np.ndarray, "*objects steps 2"],
    headings: Float64[np.ndarray, "*objects steps"],
    valid: Bool[np.ndarray, "*objects steps"],
    dt: float,
) -> Kinematics:
    """Derivatives of positions [m] and headings [rad] at steps of ``dt`` [s].

    A derivative at step i is (value at i + 1 - value at i - 1) / (2 dt), and is known where both are valid. Changes of
    headings over two steps are wrapped to +-pi. The challenge takes positions in 3-D; here they are in the plane, since
    many sources have no height.
    """
    positions = np.where(valid[..., None], positions, np.nan)
    headings = np.where(valid, headings, np.nan)
    speed = np.hypot(_central(positions[..., 0]), _central(positions[..., 1])) / dt
    turn = wrap_to_pi(2 * _central(headings)) / 2
    bend = wrap_to_pi(2 * _central(turn)) / 2
    return Kinematics(speed, _central(speed) / dt, turn / dt, bend / dt**2)


def _central(values: np.ndarray) -> np.ndarray:
    """Half the difference between the next and the previous value along the last axis; NaN at both ends."""
    change = np.full(values.shape, np.nan)
    change[..., 1:-1] = (values[..., 2:] - values[..., :-2]) / 2
    return change
