"""Scenes with faults of one kind: lane ends that do not meet, and boxes that overlap."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType, Link, Scene, empty


def chain(gap: float, lanes: int = 3) -> Scene:
    """Lanes of 10 m in a row along x; every connection has a sideways ``gap`` [m]."""
    scene = empty(1, lanes)
    for i in range(lanes):
        scene.lanes[i, :, 0] = np.linspace(10 * i, 10 * i + 10, 20)
        scene.lanes[i, :, 1] = gap * i
        scene.links[i, i] = Link.SELF
        if i:
            scene.links[i - 1, i], scene.links[i, i - 1] = Link.PREDECESSOR, Link.SUCCESSOR
    scene.lane_mask[:] = scene.lane_known[:] = True
    scene.agents[0] = (0, 0, 0, 0, 1, 0, 4, 2, 1.5)
    scene.agent_mask[:] = scene.agent_known[:] = True
    return scene


def queue(gap: float, cars: int = 4) -> Scene:
    """Cars of 4 m along x with ``gap`` [m] between their boxes; the ego comes first."""
    scene = empty(cars, 1)
    scene.agents[:] = (0, 0, 0, 3, 1, 0, 4, 2, 1.5)
    scene.agents[:, 0] = np.arange(cars) * (4 + gap)
    scene.agent_types[:] = AgentType.VEHICLE
    scene.agent_mask[:] = scene.agent_known[:] = True
    return scene
