"""The ground under a world: a slope, a hill or a dip, and gentle waves."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64


@dataclasses.dataclass(frozen=True)
class Ground:
    """Height in metres as a smooth function of place.

    Attributes:
      grade: slope along x and y; crest: height [m], width [m] and direction [rad] of a ridge through ``middle``;
        wave: height [m] and length [m] of ripples.
    """

    grade: tuple[float, float]
    crest: tuple[float, float, float]
    middle: tuple[float, float]
    wave: tuple[float, float]

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Ground:
        """Mostly flat; a tenth of all worlds is hilly."""
        hilly = rng.random() < 0.1
        grade = rng.normal(0, 0.03 if hilly else 0.01, 2).clip(-0.08, 0.08)
        crest = (float(rng.normal(0, 4.0 if hilly else 0.5)), rng.uniform(40, 90), rng.uniform(0, np.pi))
        middle = rng.uniform(-60, 60, 2)
        wave = (rng.uniform(0, 0.25), rng.uniform(40, 90))
        return cls((float(grade[0]), float(grade[1])), crest, (float(middle[0]), float(middle[1])), wave)

    def height(self, places: Float64[np.ndarray, "*n 2"]) -> Float64[np.ndarray, "*n"]:
        """Metres at each place."""
        high, width, direction = self.crest
        across = (places[..., 0] - self.middle[0]) * np.cos(direction) + (places[..., 1] - self.middle[1]) * np.sin(
            direction
        )
        ripple = self.wave[0] * np.sin(2 * np.pi * (places[..., 0] + 0.5 * places[..., 1]) / self.wave[1])
        return places @ np.array(self.grade) + high * np.exp(-((across / width) ** 2)) + ripple
