"""Colors of a canvas: the lit ground and faces, windows and leaves, headlights and haze, and the sky."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int, UInt8

from scjax.camera.camera import Camera
from scjax.camera.dashcam.look import Look
from scjax.camera.dashcam.materials import Material
from scjax.camera.dashcam.shading import (
    BAY,
    GRAIN_CELLS,
    are_windows,
    grain,
    ground_light,
    sky_colors,
    window_color,
)
from scjax.camera.dashcam.zbuffer import ZBuffer, pixel_planes, plane_values
from scjax.camera.raster import require_opencv

_LEAF_GRAIN, _LEAF_CELL = 0.22, 0.35  # share of the brightness, and m
_BEAM = 18.0  # m; depth at which headlights have lost 63 % of their light
_LEAST = 1e-4  # 1/m
_WALL, _LEAVES = 1, 2  # kinds of faces with details


class Surfaces(NamedTuple):
    """Faces in a picture.

    Attributes:
      colors: lit, 0..255.
      normals: outwards, of length 1.
      materials: ``Material``.
    """

    colors: Float32[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    materials: Int[np.ndarray, " n"]


def compose_colors(
    camera: Camera,
    buffer: ZBuffer,
    ground: UInt8[np.ndarray, "height width 3"],
    shade: UInt8[np.ndarray, "height width"] | None,
    surfaces: Surfaces,
    mount: tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, " 3"]],
    look: Look,
) -> Float32[np.ndarray, "height width 3"]:
    """Colors of a canvas, 0..255.

    Args:
      buffer: the nearest of these surfaces at every pixel.
      ground: its colors without light.
      shade: how dark shadows make it; None without any.
      mount: rotation and position of the camera in the world, its z above the ground.
    """
    cv2 = require_opencv()
    rotation, position = mount
    # Of rays in the world, one meter long along the axis of the camera.
    directions = [plane_values(row, camera.width, camera.height).ravel() for row in pixel_planes(camera, rotation)]
    depth = 1 / np.maximum(buffer.inverse_depth, np.float32(_LEAST))
    haze = np.exp(depth * np.float32(-1 / look.visibility))
    veil, kept = 1 - haze, haze
    if look.headlights:
        kept = haze * (1 + np.float32(look.headlights) * np.exp(depth * np.float32(-1 / _BEAM)))
    shades = np.arange(256, dtype=np.float32)
    on_face = buffer.faces >= 0
    if shade is not None:
        dark = cv2.LUT(shade, 1 - shades / np.float32(255))
        np.copyto(dark, np.float32(1), where=on_face)
        kept = kept * dark
    # One plane for each color: arrays of pixels with three colors each take several times as long.
    light = ground_light(look).astype(np.float32)
    planes = [cv2.LUT(plane, shades * part) for plane, part in zip(cv2.split(ground), light, strict=True)]
    if len(surfaces.colors):
        rows = buffer.faces.astype(np.intp)
        for plane, colors in zip(planes, np.ascontiguousarray(surfaces.colors.T), strict=True):
            np.copyto(plane, np.take(colors, rows, mode="clip"), where=on_face)
        _add_details([plane.ravel() for plane in planes], buffer, depth, surfaces, directions, position, look)
    sky = np.flatnonzero(buffer.inverse_depth <= 0)
    of_sky = sky_colors(directions[2][sky], look)
    for plane, horizon, color in zip(planes, (255 * np.array(look.horizon)).tolist(), of_sky, strict=True):
        plane *= kept
        cv2.scaleAdd(veil, horizon, plane, plane)
        plane.ravel()[sky] = color
    return cv2.merge(planes)


def _add_details(
    planes: Sequence[np.ndarray],
    buffer: ZBuffer,
    depth: np.ndarray,
    surfaces: Surfaces,
    directions: Sequence[np.ndarray],
    position: np.ndarray,
    look: Look,
) -> None:
    """Windows of walls, and leaves, in the planes of colors.

    In float32: places are taken from where patterns repeat, so that no precision is lost far from the origin.
    """
    kinds = np.zeros(len(surfaces.materials), np.uint8)
    kinds[surfaces.materials == Material.WALL] = _WALL
    kinds[surfaces.materials == Material.LEAVES] = _LEAVES
    faces, depth = buffer.faces.ravel(), depth.ravel()
    kind = np.take(kinds, faces, mode="clip") * (faces >= 0)
    pixels = np.flatnonzero(kind == _WALL)
    x, y = surfaces.normals[:, 0], surfaces.normals[:, 1]
    starts = ((position[1] * x - position[0] * y) % BAY).astype(np.float32)
    x, y = (part.astype(np.float32)[faces[pixels]] for part in (x, y))
    along = starts[faces[pixels]] + (directions[1][pixels] * x - directions[0][pixels] * y) * depth[pixels]
    windows = pixels[are_windows(along, np.float32(position[2]) + directions[2][pixels] * depth[pixels])]
    pixels = np.flatnonzero(kind == _LEAVES)
    origin = np.append(position[:2] % (GRAIN_CELLS * _LEAF_CELL), position[2]).astype(np.float32)
    places = [start + along[pixels] * depth[pixels] for start, along in zip(origin, directions, strict=True)]
    shares = 1 + np.float32(_LEAF_GRAIN) * grain(places, _LEAF_CELL)
    for plane, glass in zip(planes, window_color(look), strict=True):
        plane[windows] = glass
        plane[pixels] *= shares
