"""How objects look: cars, large vehicles, people, cyclists, cones, barriers and other boxes, as parts of their box."""

from __future__ import annotations

import dataclasses
import enum

import numpy as np
from jaxtyping import Float64, Int

from scjax.camera.dashcam.materials import Material
from scjax.camera.dashcam.solids import FRONT, LEFT, REAR, RIGHT, TOP, SolidPart, part_corners, part_materials
from scjax.scene import AgentType
from scjax.scene.scene import LARGE_LENGTH

_HIGH = 2.0  # m; higher cars are vans
_LONG = 1.2  # m; longer obstacles are barriers, shorter ones cones


class Shape(enum.IntEnum):
    """Kinds of shapes."""

    CAR = 0
    LARGE = 1
    VAN = 2
    PERSON = 3
    CYCLIST = 4
    CONE = 5
    BARRIER = 6
    BLOCK = 7


@dataclasses.dataclass(frozen=True)
class ShapeParts:
    """Corners of the parts of a shape in shares of its box [parts, 8, 3], their materials [parts, 6], and how many of
    the first parts show it from afar."""

    corners: Float64[np.ndarray, "parts 8 3"]
    materials: Int[np.ndarray, "parts 6"]
    coarse: int


def shape_of(types: Int[np.ndarray, " n"], sizes: Float64[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """The shape of objects of these types and sizes [m]."""
    length = np.maximum(sizes[:, 0], sizes[:, 1])
    small = np.where(sizes[:, 2] > _HIGH, Shape.VAN, Shape.CAR)
    vehicle = np.where(sizes[:, 0] > LARGE_LENGTH, Shape.LARGE, small)
    static = np.where(length > _LONG, Shape.BARRIER, Shape.CONE)
    cases = [types == kind for kind in AgentType]
    return np.select(cases, [vehicle, Shape.PERSON, Shape.CYCLIST, static], Shape.BLOCK)


def _wheels(x: float, width: float, radius: float, length: float) -> list[SolidPart]:
    """Two pairs of wheels at x and -x."""
    return [
        SolidPart((cx - length, cy - width, 0.0), (cx + length, cy + width, radius), Material.TIRE)
        for cx in (-x, x)
        for cy in (-0.5 + width, 0.5 - width)
    ]


def _lights(z: float, height: float) -> list[SolidPart]:
    """Tail lights and headlights, just outside of the body."""
    lights = []
    for side in (-1, 1):
        low, high = sorted((side * 0.30, side * 0.46))
        lights.append(SolidPart((-0.505, low, z), (-0.45, high, z + height), Material.TAIL_LIGHT))
        lights.append(SolidPart((0.45, low, z - 0.06), (0.503, high, z + height - 0.08), Material.HEADLIGHT))
    return lights


_GLASS = tuple((face, Material.GLASS) for face in (FRONT, REAR, LEFT, RIGHT))
_CAR = [
    SolidPart((-0.5, -0.5, 0.17), (0.5, 0.5, 0.60), Material.PAINT, taper=(0.015, 0.03, 0.03)),
    SolidPart((-0.42, -0.46, 0.60), (0.26, 0.46, 1.0), Material.PAINT, taper=(0.10, 0.14, 0.09), faces=_GLASS),
    *_wheels(0.31, 0.06, 0.40, 0.075),
    *_lights(0.44, 0.12),
]
_LARGE = [
    SolidPart((-0.5, -0.5, 0.14), (0.30, 0.5, 1.0), Material.PAINT),
    SolidPart((0.31, -0.48, 0.12), (0.5, 0.48, 0.82), Material.PAINT, taper=(0.0, 0.02, 0.02)),
    SolidPart((0.37, -0.485, 0.46), (0.502, 0.485, 0.74), Material.GLASS, taper=(0.0, 0.015, 0.01)),
    *_wheels(0.36, 0.06, 0.28, 0.05),
    *_lights(0.20, 0.07),
    SolidPart((-0.504, -0.5, 0.13), (-0.49, 0.5, 0.17), Material.METAL),
]
_VAN = [
    SolidPart((-0.5, -0.5, 0.14), (0.5, 0.5, 0.52), Material.PAINT, taper=(0.0, 0.05, 0.01)),
    SolidPart((-0.5, -0.49, 0.52), (0.40, 0.49, 1.0), Material.PAINT, taper=(0.01, 0.13, 0.05)),
    SolidPart((0.05, -0.495, 0.56), (0.40, 0.495, 0.88), Material.GLASS, taper=(0.0, 0.085, 0.034)),
    *_wheels(0.33, 0.06, 0.32, 0.07),
    *_lights(0.36, 0.09),
]
_PERSON = [
    SolidPart((-0.17, -0.28, 0.0), (0.17, 0.28, 0.48), Material.TROUSERS, taper=(-0.05, -0.05, -0.04)),
    SolidPart((-0.25, -0.40, 0.47), (0.25, 0.40, 0.84), Material.CLOTH, taper=(0.06, 0.06, 0.06)),
    SolidPart((-0.16, -0.17, 0.84), (0.20, 0.17, 1.0), Material.SKIN, taper=(0.05, 0.05, 0.05)),
]
_CYCLIST = [
    SolidPart((-0.20, -0.30, 0.50), (0.20, 0.30, 0.84), Material.CLOTH, taper=(0.02, -0.06, 0.06)),
    SolidPart((-0.04, -0.16, 0.84), (0.18, 0.16, 1.0), Material.SKIN, taper=(0.02, 0.02, 0.04)),
    SolidPart((-0.5, -0.05, 0.0), (-0.14, 0.05, 0.40), Material.TIRE, taper=(0.06, 0.06, 0.0)),
    SolidPart((0.14, -0.05, 0.0), (0.5, 0.05, 0.40), Material.TIRE, taper=(0.06, 0.06, 0.0)),
    SolidPart((-0.20, -0.06, 0.28), (0.26, 0.06, 0.42), Material.METAL),
    SolidPart((-0.10, -0.22, 0.22), (0.10, 0.22, 0.52), Material.TROUSERS),
    SolidPart((0.20, -0.45, 0.55), (0.26, 0.45, 0.60), Material.METAL),
]
_CONE = [
    SolidPart((-0.36, -0.36, 0.05), (0.36, 0.36, 0.42), Material.CONE, taper=(0.12, 0.12, 0.12)),
    SolidPart((-0.24, -0.24, 0.42), (0.24, 0.24, 0.68), Material.WHITE, taper=(0.08, 0.08, 0.08)),
    SolidPart((-0.16, -0.16, 0.68), (0.16, 0.16, 1.0), Material.CONE, taper=(0.11, 0.11, 0.11)),
    SolidPart((-0.5, -0.5, 0.0), (0.5, 0.5, 0.06), Material.CONE),
]
_BARRIER = [
    SolidPart((-0.5 + k / 6, -0.5, 0.25), (-0.5 + (k + 1) / 6, 0.5, 1.0), Material.CONE if k % 2 else Material.WHITE)
    for k in range(6)
] + [SolidPart((-0.5, -0.35, 0.0), (0.5, 0.35, 0.25), Material.METAL)]
_BLOCK = [SolidPart((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0), Material.METAL, faces=((TOP, Material.PAINT),))]


def _shape(parts: list[SolidPart], coarse: int) -> ShapeParts:
    return ShapeParts(part_corners(parts), part_materials(parts), coarse)


SHAPES: dict[Shape, ShapeParts] = {
    Shape.CAR: _shape(_CAR, 2),
    Shape.LARGE: _shape(_LARGE, 3),
    Shape.VAN: _shape(_VAN, 3),
    Shape.PERSON: _shape(_PERSON, 3),
    Shape.CYCLIST: _shape(_CYCLIST, 4),
    Shape.CONE: _shape(_CONE, 3),
    Shape.BARRIER: _shape(_BARRIER, 7),
    Shape.BLOCK: _shape(_BLOCK, 1),
}
