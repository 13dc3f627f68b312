"""A small valid scene, made of random numbers, for tests that need one."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType, Crop, Link, Scene, Signal, empty, stack


def example_scene(seed: int = 0, *, agents: int = 4, lanes: int = 5, padding: int = 2, crop=Crop.CENTERED) -> Scene:
    """A chain of lanes, a pair of neighbours, some values unknown; ``padding`` empty slots of each kind at the end."""
    rng = np.random.default_rng(seed)
    scene = empty(agents + padding, lanes + padding, crop=crop, domain=1)
    heading = rng.uniform(-np.pi, np.pi, agents)
    states = rng.uniform(0.3, 1.4, (agents, 9))
    ahead = np.array([32.0 if crop == Crop.FORWARD else 0.0, 0.0, 0.0])
    states[:, :2] = rng.uniform(-30, 30, (agents, 2)) + ahead[:2]
    states[:, 3] *= 8
    states[:, 4], states[:, 5] = np.cos(heading), np.sin(heading)
    scene.agents[:agents] = states
    scene.agent_types[:agents] = rng.integers(0, len(AgentType), agents)
    scene.agent_mask[:agents] = True
    scene.agent_known[:agents] = True
    scene.agent_known[1:agents:2, 2] = False
    starts = rng.uniform(-20, 20, (lanes, 1, 3)) * np.array([1, 1, 0.1]) + ahead
    steps = np.concatenate([rng.uniform(-1, 1, (lanes, 1, 2)), np.zeros((lanes, 1, 1))], -1)
    scene.lanes[:lanes] = starts + np.arange(20)[:, None] * 0.5 * steps
    scene.lane_mask[:lanes] = True
    scene.lane_known[:lanes] = True
    scene.lane_known[0, 2] = False
    scene.signals[:lanes] = rng.integers(0, len(Signal), lanes)
    rows = np.arange(lanes)
    scene.links[rows, rows] = Link.SELF
    for i in range(lanes - 2):
        scene.links[i, i + 1], scene.links[i + 1, i] = Link.PREDECESSOR, Link.SUCCESSOR
    if lanes > 1:
        scene.links[lanes - 2, lanes - 1], scene.links[lanes - 1, lanes - 2] = Link.LEFT, Link.RIGHT
    return scene


def example_batch(size: int = 3, **options) -> Scene:
    """``size`` different example scenes as a batch."""
    return stack([example_scene(seed, **options) for seed in range(size)])
