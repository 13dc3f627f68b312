"""Small scenes for energies: two lanes in a row with a gap, boxes at chosen poses."""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import numpy as np

from scjax.scene import AgentType, Link, Scene, empty, stack


def two_lanes(gap=(0.0, 0.0)) -> Scene:
    """Two linked lanes of 20 m in a row to the east; the second is shifted by ``gap`` (x, y) [m]."""
    scene = empty(0, 2)
    for i in range(2):
        scene.lanes[i, :, 0] = np.linspace(20 * i, 20 * i + 20, 20)
    scene.lanes[1, :, :2] += np.asarray(gap, np.float32)
    scene.links[:] = [[Link.SELF, Link.PREDECESSOR], [Link.SUCCESSOR, Link.SELF]]
    scene.lane_mask[:] = scene.lane_known[:] = True
    return scene


def boxes(*poses, size=(4.0, 2.0), speed=0.0, agent_type=AgentType.VEHICLE) -> Scene:
    """Agents of one size [m] and type at (x, y, heading [degrees])."""
    scene = empty(len(poses), 0)
    for i, (x, y, heading) in enumerate(poses):
        angle = np.deg2rad(heading)
        scene.agents[i] = (x, y, 0, speed, np.cos(angle), np.sin(angle), *size, 1.5)
    scene.agent_types[:] = agent_type
    scene.agent_mask[:] = scene.agent_known[:] = True
    return scene


@functools.cache
def _program(energy: Callable, options: tuple) -> Callable:
    """Called by itself, an energy would compile a program for each of its operations."""
    return jax.jit(functools.partial(energy, **dict(options)))


def scene_energy(energy: Callable, scene: Scene, **options) -> float:
    """Energy of a single scene."""
    return float(_program(energy, tuple(options.items()))(stack([scene]))[0])
