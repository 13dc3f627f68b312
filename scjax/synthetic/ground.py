"""Terrain of a world: a slope, a ridge and small undulations."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64

_HILLY_SHARE = 0.1  # of all worlds
_MAX_GRADE = 0.08


@dataclasses.dataclass(frozen=True)
class Ground:
    """Height of the ground as a smooth function of the position.

    Attributes:
      grade: slope along x and y.
      ridge_height, ridge_width, ridge_direction: of a ridge through ``ridge_center`` [m, m, rad]; a negative height
        is a dip.
      ridge_center: [m].
      wave_height, wave_length: of small undulations [m].
    """

    grade: tuple[float, float]
    ridge_height: float
    ridge_width: float
    ridge_direction: float
    ridge_center: tuple[float, float]
    wave_height: float
    wave_length: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Ground:
        """Random ground, flat for nine worlds out of ten."""
        is_hilly = rng.random() < _HILLY_SHARE
        grade = rng.normal(0, 0.03 if is_hilly else 0.01, 2).clip(-_MAX_GRADE, _MAX_GRADE)
        ridge_height = float(rng.normal(0, 4.0 if is_hilly else 0.5))
        ridge_width, ridge_direction = rng.uniform(40, 90), rng.uniform(0, np.pi)
        center = rng.uniform(-60, 60, 2)
        return cls(
            grade=(float(grade[0]), float(grade[1])),
            ridge_height=ridge_height,
            ridge_width=ridge_width,
            ridge_direction=ridge_direction,
            ridge_center=(float(center[0]), float(center[1])),
            wave_height=rng.uniform(0, 0.25),
            wave_length=rng.uniform(40, 90),
        )

    def height(self, positions: Float64[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n"]:
        """Height at each position [m]."""
        x, y = positions[..., 0], positions[..., 1]
        cos, sin = np.cos(self.ridge_direction), np.sin(self.ridge_direction)
        across = (x - self.ridge_center[0]) * cos + (y - self.ridge_center[1]) * sin
        undulation = self.wave_height * np.sin(2 * np.pi * (x + 0.5 * y) / self.wave_length)
        ridge = self.ridge_height * np.exp(-((across / self.ridge_width) ** 2))
        return positions @ np.array(self.grade) + ridge + undulation
