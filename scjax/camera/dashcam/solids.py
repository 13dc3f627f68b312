"""Convex solids of six faces, of which everything that stands on the ground is built."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.camera.dashcam.materials import Material

FRONT, REAR, LEFT, RIGHT, TOP, BOTTOM = range(6)
"""Faces, in the order of ``scjax.camera.agent_boxes.FACES``."""


class Solids(NamedTuple):
    """Solids in the world.

    Attributes:
      corners: as of ``box_corners_3d`` [m].
      colors: of each face, 0..1.
      materials: ``Material`` of each face.
      classes: ``SemanticClass``.
      ids: index of the object, -1 for what is no object.
    """

    corners: Float64[np.ndarray, "n 8 3"]
    colors: Float64[np.ndarray, "n 6 3"]
    materials: Int[np.ndarray, "n 6"]
    classes: Int[np.ndarray, " n"]
    ids: Int[np.ndarray, " n"]


class SolidPart(NamedTuple):
    """A solid of a shape, in shares of the length, width and height of its box, from the middle of its bottom.

    Attributes:
      low, high: ranges of x, y in -0.5..0.5 and of z in 0..1.
      taper: how much the top is smaller than the bottom: at the rear, at the front, at both sides (shares of the box).
      material: of all faces but those of ``faces``.
      faces: face -> material.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    material: Material
    taper: tuple[float, float, float] = (0.0, 0.0, 0.0)
    faces: tuple[tuple[int, Material], ...] = ()


def part_corners(parts: Sequence[SolidPart]) -> Float64[np.ndarray, "parts 8 3"]:
    """Corners of parts, in shares of their box."""
    corners = np.empty((len(parts), 8, 3))
    for row, part in enumerate(parts):
        (x0, y0, z0), (x1, y1, z1), (rear, front, side) = part.low, part.high, part.taper
        corners[row, :4] = [(x1, y0, z0), (x1, y1, z0), (x0, y1, z0), (x0, y0, z0)]
        x0, x1, y0, y1 = x0 + rear, x1 - front, y0 + side, y1 - side
        corners[row, 4:] = [(x1, y0, z1), (x1, y1, z1), (x0, y1, z1), (x0, y0, z1)]
    return corners


def part_materials(parts: Sequence[SolidPart]) -> Int[np.ndarray, "parts 6"]:
    """Material of each face of parts."""
    materials = np.repeat(np.array([part.material for part in parts])[:, None], 6, 1)
    for row, part in enumerate(parts):
        for face, material in part.faces:
            materials[row, face] = material
    return materials


def place_parts(
    corners: Float64[np.ndarray, "parts 8 3"],
    places: Float64[np.ndarray, "n 3"],
    headings: Float64[np.ndarray, " n"],
    sizes: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "n parts 8 3"]:
    """Parts of a shape at places on the ground [m], scaled to sizes."""
    scaled = corners[None] * sizes[:, None, None]
    cos, sin = np.cos(headings)[:, None, None], np.sin(headings)[:, None, None]
    x, y = cos * scaled[..., 0] - sin * scaled[..., 1], sin * scaled[..., 0] + cos * scaled[..., 1]
    return np.stack([x, y, scaled[..., 2]], -1) + places[:, None, None]


def join_solids(groups: Sequence[Solids]) -> Solids:
    """All solids of several groups."""
    return Solids(*(np.concatenate(fields) for fields in zip(*groups, strict=True)))


def no_solids() -> Solids:
    """An empty group."""
    return Solids(np.zeros((0, 8, 3)), np.zeros((0, 6, 3)), np.zeros((0, 6), int), np.zeros(0, int), np.zeros(0, int))
