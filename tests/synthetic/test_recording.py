"""Worlds as logs."""

from __future__ import annotations

import numpy as np

from scjax.scene import validate
from scjax.synthetic.recording import to_log
from tests.factories.synthetic_scenes import example_worlds, scenes_of


def test_to_log_mirrors_left_hand_worlds():
    world = next(world for world in example_worlds() if world.mirrored)
    log = to_log(world)
    np.testing.assert_allclose(log.lanes[0].points[:, :2], world.net.lanes[0].points * [1, -1])
    positions = log.positions[np.arange(len(world.moments[0])), 0]
    np.testing.assert_allclose(positions[:, 1], -world.moments[0].positions[:, 1])
    for map_lane, lane in zip(log.lanes, world.net.lanes, strict=True):
        assert [int(name) for name, *_ in map_lane.left_neighbors] == ([] if lane.right is None else [lane.right])


def test_scenes_of_worlds_are_valid():
    for world in example_worlds():
        for _, scene in scenes_of(world):
            validate(scene)
