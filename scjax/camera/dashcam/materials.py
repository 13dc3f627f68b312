"""What surfaces are made of: colors, and the semantic class of what they belong to."""

from __future__ import annotations

import enum

import numpy as np

from scjax.scene import AgentType


class SemanticClass(enum.IntEnum):
    """What a pixel of a rendered dashcam shows."""

    SKY = 0
    TERRAIN = 1
    SIDEWALK = 2
    ROAD = 3
    MARKING = 4
    VEHICLE = 5
    PEDESTRIAN = 6
    CYCLIST = 7
    STATIC = 8
    OTHER = 9
    SIGNAL = 10
    BUILDING = 11
    VEGETATION = 12


AGENT_CLASSES = {
    AgentType.VEHICLE: SemanticClass.VEHICLE,
    AgentType.PEDESTRIAN: SemanticClass.PEDESTRIAN,
    AgentType.CYCLIST: SemanticClass.CYCLIST,
    AgentType.STATIC: SemanticClass.STATIC,
}


class Material(enum.IntEnum):
    """Surfaces of objects. ``PAINT`` and ``CLOTH`` have colors of their own on every object."""

    PAINT = 0
    CLOTH = 1
    TROUSERS = 2
    SKIN = 3
    GLASS = 4
    TIRE = 5
    TAIL_LIGHT = 6
    HEADLIGHT = 7
    METAL = 8
    CONE = 9
    WHITE = 10
    WALL = 11
    ROOF = 12
    TRUNK = 13
    LEAVES = 14
    SIGNAL_BOX = 15
    LAMP_GO = 16
    LAMP_CAUTION = 17
    LAMP_STOP = 18


COLORS = np.zeros((len(Material), 3))
"""Color of each material, 0..1; those that objects choose are placeholders."""

for _material, _color in {
    Material.SKIN: (0.72, 0.53, 0.42),
    Material.GLASS: (0.10, 0.13, 0.16),
    Material.TIRE: (0.05, 0.05, 0.05),
    Material.TAIL_LIGHT: (0.75, 0.04, 0.04),
    Material.HEADLIGHT: (0.95, 0.94, 0.85),
    Material.METAL: (0.35, 0.36, 0.38),
    Material.CONE: (0.95, 0.38, 0.06),
    Material.WHITE: (0.92, 0.92, 0.92),
    Material.TRUNK: (0.30, 0.22, 0.15),
    Material.SIGNAL_BOX: (0.06, 0.07, 0.06),
    Material.LAMP_GO: (0.10, 0.95, 0.55),
    Material.LAMP_CAUTION: (1.0, 0.75, 0.10),
    Material.LAMP_STOP: (1.0, 0.12, 0.08),
}.items():
    COLORS[_material] = _color

GLOWING = np.isin(np.arange(len(Material)), (Material.LAMP_GO, Material.LAMP_CAUTION, Material.LAMP_STOP))
"""Materials that shine by themselves."""

PAINTS = np.array(
    [
        *((0.90, 0.90, 0.90), (0.08, 0.08, 0.09), (0.55, 0.57, 0.60), (0.30, 0.32, 0.35)),
        *((0.55, 0.06, 0.07), (0.08, 0.17, 0.45), (0.12, 0.28, 0.20), (0.78, 0.72, 0.60), (0.85, 0.65, 0.12)),
    ]
)
"""Colors of cars; the first are the most usual."""

PAINT_SHARES = np.array([0.24, 0.20, 0.18, 0.13, 0.08, 0.08, 0.03, 0.04, 0.02])
WALLS = np.array([(0.66, 0.60, 0.52), (0.55, 0.36, 0.29), (0.72, 0.72, 0.70), (0.45, 0.47, 0.50), (0.80, 0.76, 0.66)])
LEAVES = np.array([(0.16, 0.30, 0.10), (0.22, 0.36, 0.13), (0.30, 0.36, 0.14), (0.13, 0.24, 0.12)])
