"""Light on surfaces, windows, grain, sky and haze; then what the camera adds."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, UInt8

from scjax.camera.agent_boxes import FACES, face_normals
from scjax.camera.camera import Camera
from scjax.camera.dashcam.look import Look
from scjax.camera.dashcam.materials import GLOWING, Material
from scjax.camera.dashcam.solids import Solids
from scjax.camera.raster import require_opencv

_FLOOR, _WINDOW_LOW, _WINDOW_HIGH = 3.2, 1.0, 2.4  # m, of facades
_SKY_STEPS, _SKY_TOP = 256, 0.7  # colors between the horizon and the top of the sky, which has this slope
BAY, _BAY_LOW, _BAY_HIGH = 2.6, 0.6, 2.0  # m
"""Width of a part of a facade, after which it repeats [m]."""

GRAIN_CELLS = 256
"""Cells of the table of grain, which repeats."""


def face_colors(
    solids: Solids, solid: Int[np.ndarray, " n"], face: Int[np.ndarray, " n"], look: Look
) -> tuple[Float32[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Lit colors of faces, 0..255, and their normals."""
    quads = solids.corners[solid[:, None], FACES[face]]
    normals = face_normals(quads)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    base, material = solids.colors[solid, face], solids.materials[solid, face]
    sky = 0.75 + 0.25 * normals[:, 2:]  # faces that look up see more of the sky
    light = np.array(look.ambient) * sky + np.array(look.sun_color) * (normals @ look.to_sun).clip(0, None)[:, None]
    colors = base * light
    colors[material == Material.GLASS] += 0.18 * np.array(look.horizon)
    night = max(0.0, 0.5 - float(np.mean(look.ambient)) - float(np.mean(look.sun_color)))
    lamps = np.isin(material, (Material.TAIL_LIGHT, Material.HEADLIGHT))
    colors = np.where(GLOWING[material][:, None], base, np.where(lamps[:, None], colors + 2 * night * base, colors))
    return (255 * colors).astype(np.float32), normals


def ground_light(look: Look) -> np.ndarray:
    """Light on level ground, for each channel."""
    return np.array(look.ambient) + np.array(look.sun_color) * max(look.to_sun[2], 0.0)


def are_windows(along: Float32[np.ndarray, " n"], height: Float32[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which places of walls are windows, by their distance along the wall and their height [m]."""
    floor, bay = _share(height, _FLOOR), _share(along, BAY)
    inside = (floor > _WINDOW_LOW / _FLOOR) & (floor < _WINDOW_HIGH / _FLOOR)
    return inside & (bay > _BAY_LOW / BAY) & (bay < _BAY_HIGH / BAY)


def _share(values: Float32[np.ndarray, " n"], period: float) -> Float32[np.ndarray, " n"]:
    """How far in their period values are, 0 to 1."""
    shares = values * np.float32(1 / period)
    return shares - np.floor(shares)


def window_color(look: Look) -> Float32[np.ndarray, " 3"]:
    """Color of windows, 0..255."""
    return (255 * (0.10 + 0.30 * np.array(look.horizon))).astype(np.float32)


def grain(places: Sequence[Float32[np.ndarray, " n"]], cell: float) -> Float32[np.ndarray, " n"]:
    """Random numbers around 0 that stick to places x, y, z of the world: one for each cell [m].

    They repeat after ``GRAIN_CELLS`` cells to the x and y sides.
    """
    x, y, z = (np.floor(part * np.float32(1 / cell)).astype(np.int32) for part in places)
    return _grain_table()[(x + 37 * z) & (GRAIN_CELLS - 1), y & (GRAIN_CELLS - 1)]


@functools.cache
def _grain_table() -> Float32[np.ndarray, "256 256"]:
    return np.random.default_rng(0).uniform(-1, 1, (GRAIN_CELLS, GRAIN_CELLS)).astype(np.float32)


def sky_colors(slope: Float32[np.ndarray, " n"], look: Look) -> Float32[np.ndarray, "3 n"]:
    """Colors of the sky at vertical directions, meters up per meter along the axis of the camera; 0..255."""
    share = (np.arange(_SKY_STEPS) / (_SKY_STEPS - 1))[:, None] ** 0.7
    table = 255 * ((1 - share) * np.array(look.horizon) + share * np.array(look.zenith))
    index = (slope * np.float32((_SKY_STEPS - 1) / _SKY_TOP)).clip(0, _SKY_STEPS - 1).astype(np.intp)
    return np.take(table.T.astype(np.float32), index, 1)


def finish(
    picture: Float32[np.ndarray, "height width 3"], camera: Camera, look: Look, step: int
) -> UInt8[np.ndarray, "height width 3"]:
    """Exposure, contrast, saturation, vignette and noise of the camera."""
    cv2 = require_opencv()
    if look.saturation != 1.0:
        gray = cv2.transform(picture, np.array([[0.30, 0.59, 0.11]], np.float32))
        picture = cv2.addWeighted(picture, look.saturation, cv2.merge([gray] * 3), 1 - look.saturation, 0.0)
    picture = picture * np.float32(look.exposure * look.contrast)
    if look.contrast != 1.0:
        picture += np.float32(110 * (1 - look.contrast))
    if look.vignette:
        picture *= _vignette(camera.height, camera.width, round(look.vignette, 3))
    if look.noise:
        picture += _noise(look.seed, step, picture.shape) * np.float32(255 * look.noise)
    return np.clip(picture, 0, 255).astype(np.uint8)


@functools.lru_cache(maxsize=16)
def _vignette(height: int, width: int, share: float) -> np.ndarray:
    y, x = np.linspace(-1, 1, height)[:, None], np.linspace(-1, 1, width)
    return (1 - share * (x * x + y * y) / 2)[..., None].astype(np.float32)


def _noise(seed: int, step: int, shape: tuple[int, ...]) -> np.ndarray:
    """Normal numbers for a picture: a stretch of a long table at a place that depends on seed and step."""
    count, table = int(np.prod(shape)), _noise_table()
    start = int(np.random.default_rng([seed, step]).integers(len(table)))
    if start + count <= len(table):
        return table[start : start + count].reshape(shape)
    return np.resize(np.roll(table, -start), count).reshape(shape)


@functools.cache
def _noise_table() -> np.ndarray:
    return np.random.default_rng(1).standard_normal(1 << 21, np.float32)
