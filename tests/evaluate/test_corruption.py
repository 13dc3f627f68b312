"""The corruption ladder: shares that are kept, and scenes with few elements."""

import numpy as np

from scjax.evaluate.corruption import mix_scenes
from tests.factories.traffic import agent, random_traffic, scene

REFERENCE, OTHER = random_traffic(1), random_traffic(2)


def test_mix_scenes_keeps_everything_with_full_shares():
    mixed = mix_scenes(REFERENCE, OTHER, 1.0, 1.0, np.random.default_rng(0))
    assert mixed.lanes.shape == REFERENCE.lanes.shape
    order = [np.argmin(np.abs(REFERENCE.agents[:, 6:] - row[6:]).sum(1)) for row in mixed.agents]
    np.testing.assert_array_equal(mixed.agents[0], REFERENCE.agents[0])
    shift = np.linalg.norm(mixed.agents[:, :2] - REFERENCE.agents[order, :2], axis=1)
    assert 0.2 < shift[1:].mean() < 3


def test_mix_scenes_takes_the_other_scene_with_zero_shares():
    mixed = mix_scenes(REFERENCE, OTHER, 0.0, 0.0, np.random.default_rng(0))
    assert len(mixed.lane_mask) == min(len(REFERENCE.lane_mask), len(OTHER.lane_mask))
    assert {tuple(row) for row in mixed.lanes[:, 0]} <= {tuple(row) for row in OTHER.lanes[:, 0]}


def test_mix_scenes_without_lanes_or_other_agents():
    mixed = mix_scenes(scene([agent(0, 0)]), OTHER, 0.5, 0.5, np.random.default_rng(0))
    assert len(mixed.agent_mask) == 1 and not len(mixed.lane_mask)
