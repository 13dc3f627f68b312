"""How a rendered dashcam looks: light, weather, colors, mount, lens and noise, drawn from a seed."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64

from scjax.camera.camera import Camera, camera_rotation

Rgb = tuple[float, float, float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Look:
    """Appearance of a rendered dashcam. The default is a clear day through an ideal camera.

    Attributes:
      seed: of colors of objects, buildings, trees and noise.
      sun: azimuth and elevation in the frame of the log [degrees].
      sun_color, ambient: light of the sun and of the sky, 0 is none.
      zenith, horizon: colors of the sky, 0..1.
      shadows: how dark shadows are, 0..1.
      headlights: light of the carrier on what is near, compared with ``ambient``.
      visibility: depth at which haze of the color of the horizon hides 63 % [m].
      road, sidewalk, terrain, marking: colors of the ground.
      exposure, contrast, saturation: of the picture; 1 changes nothing.
      vignette: loss of light in the corners, 0..1.
      noise: standard deviation of a channel, 0..1.
      raise_by, pitch_by, roll_by: of the mount [m, degrees].
      lens: radial distortion k1 of the picture; 0 for none.
    """

    seed: int = 0
    sun: tuple[float, float] = (40.0, 45.0)
    sun_color: Rgb = (0.75, 0.72, 0.65)
    ambient: Rgb = (0.42, 0.45, 0.50)
    zenith: Rgb = (0.35, 0.55, 0.85)
    horizon: Rgb = (0.80, 0.87, 0.93)
    shadows: float = 0.45
    headlights: float = 0.0
    visibility: float = 400.0
    road: Rgb = (0.34, 0.34, 0.35)
    sidewalk: Rgb = (0.58, 0.56, 0.53)
    terrain: Rgb = (0.38, 0.43, 0.24)
    marking: Rgb = (0.92, 0.92, 0.90)
    exposure: float = 1.0
    contrast: float = 1.0
    saturation: float = 1.0
    vignette: float = 0.0
    noise: float = 0.0
    raise_by: float = 0.0
    pitch_by: float = 0.0
    roll_by: float = 0.0
    lens: float = 0.0

    @property
    def to_sun(self) -> Float64[np.ndarray, " 3"]:
        """Unit vector to the sun in the frame of the log."""
        azimuth, elevation = np.deg2rad(self.sun)
        flat = np.cos(elevation)
        return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])

    def varied_camera(self, camera: Camera) -> Camera:
        """The camera with the mount and the lens of this look."""
        turn = camera_rotation(0.0, self.pitch_by, self.roll_by)
        level = camera_rotation()
        return dataclasses.replace(
            camera,
            rotation=camera.rotation @ level.T @ turn,
            translation=camera.translation + np.array([0.0, 0.0, self.raise_by]),
            distortion=np.array([self.lens, 0.0, 0.0, 0.0, 0.0]) if self.lens else camera.distortion,
        )


WEATHER: dict[str, Look] = {
    "clear": Look(),
    "overcast": Look(
        sun_color=(0.18, 0.18, 0.18),
        ambient=(0.72, 0.73, 0.75),
        zenith=(0.66, 0.70, 0.74),
        horizon=(0.80, 0.81, 0.82),
        shadows=0.12,
        visibility=250.0,
        saturation=0.85,
    ),
    "fog": Look(
        sun_color=(0.08, 0.08, 0.08),
        ambient=(0.75, 0.76, 0.78),
        zenith=(0.74, 0.76, 0.78),
        horizon=(0.78, 0.79, 0.80),
        shadows=0.05,
        visibility=60.0,
        saturation=0.7,
    ),
    "rain": Look(
        sun_color=(0.05, 0.05, 0.06),
        ambient=(0.52, 0.55, 0.60),
        zenith=(0.45, 0.49, 0.54),
        horizon=(0.58, 0.61, 0.65),
        shadows=0.08,
        visibility=140.0,
        road=(0.22, 0.23, 0.25),
        saturation=0.75,
    ),
    "dusk": Look(
        sun=(40.0, 9.0),
        sun_color=(0.75, 0.42, 0.20),
        ambient=(0.28, 0.28, 0.38),
        zenith=(0.22, 0.27, 0.48),
        horizon=(0.92, 0.60, 0.38),
        shadows=0.35,
        headlights=0.15,
        visibility=300.0,
    ),
    "night": Look(
        sun_color=(0.0, 0.0, 0.0),
        ambient=(0.26, 0.27, 0.33),
        zenith=(0.01, 0.01, 0.03),
        horizon=(0.05, 0.05, 0.08),
        shadows=0.0,
        headlights=2.5,
        visibility=120.0,
        noise=0.01,
    ),
}
"""Looks from which ``random_look`` starts."""

_SHARES = {"clear": 0.45, "overcast": 0.25, "dusk": 0.1, "rain": 0.1, "fog": 0.05, "night": 0.05}


def random_look(seed: int, weather: str | None = None) -> Look:
    """A look that depends on the seed alone.

    Args:
      seed: a whole number of at least 0.
      weather: one of ``WEATHER``; by default drawn too.

    Raises:
      ValueError: there is no such weather.
    """
    rng = np.random.default_rng([seed, 0xCA])
    drawn = str(rng.choice(list(_SHARES), p=list(_SHARES.values())))
    name = weather or drawn
    if name not in WEATHER:
        raise ValueError(f"there is no weather {name!r}: choose from {', '.join(WEATHER)}")
    look = WEATHER[name]
    tint = rng.normal(1.0, 0.04, 3)

    def around(color: Rgb, spread: float) -> Rgb:
        values = np.array(color) * rng.normal(1.0, spread) * tint
        red, green, blue = values.clip(0.0, 1.2).tolist()
        return red, green, blue

    low_sun = look.sun[1] < 20
    terrain = [(0.38, 0.43, 0.24), (0.50, 0.45, 0.33), (0.45, 0.44, 0.42)][int(rng.integers(3))]
    return dataclasses.replace(
        look,
        seed=seed,
        sun=(float(rng.uniform(-180, 180)), float(rng.uniform(5, 14) if low_sun else rng.uniform(20, 70))),
        sun_color=around(look.sun_color, 0.15),
        ambient=around(look.ambient, 0.12),
        zenith=around(look.zenith, 0.1),
        horizon=around(look.horizon, 0.06),
        visibility=look.visibility * float(np.exp(rng.normal(0, 0.25))),
        road=around(look.road, 0.15),
        sidewalk=around(look.sidewalk, 0.1),
        terrain=around(terrain, 0.12),
        marking=around(look.marking, 0.08),
        exposure=float(np.exp(rng.normal(0, 0.12))),
        contrast=float(np.exp(rng.normal(0, 0.08))),
        saturation=look.saturation * float(np.exp(rng.normal(0, 0.12))),
        vignette=float(rng.uniform(0, 0.35)),
        noise=look.noise + float(rng.uniform(0, 0.02)),
        raise_by=float(rng.normal(0, 0.12)),
        pitch_by=float(rng.normal(0, 1.0)),
        roll_by=float(rng.normal(0, 0.4)),
        lens=float(rng.uniform(-0.18, 0.02)) if rng.random() < 0.5 else 0.0,
    )
