"""Usual sizes and speeds of the classes of agents."""

from __future__ import annotations

from scjax.scene.scene import AgentType

# Mean length, width, height of each class on real tiles [m] (WOMD; static objects: cones and barriers).
CLASS_SIZES = {
    AgentType.VEHICLE: (4.87, 2.15, 1.80),
    AgentType.PEDESTRIAN: (0.92, 0.85, 1.71),
    AgentType.CYCLIST: (1.83, 0.85, 1.79),
    AgentType.STATIC: (0.60, 0.60, 1.00),
}
CLASS_SPEEDS = {
    AgentType.VEHICLE: 8.0,
    AgentType.PEDESTRIAN: 1.4,
    AgentType.CYCLIST: 4.0,
    AgentType.STATIC: 0.0,
}
"""Usual speed of a moving agent of each class [m/s]."""
