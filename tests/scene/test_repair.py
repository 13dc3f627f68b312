"""Repairs of lanes, connections and boxes; sound, known and padded elements do not move."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.metrics.realism import connection_gaps, overlapping_pairs
from scjax.scene import Link, Scene, pad, stack
from scjax.scene.repair import close_connections, repair, separate_boxes, smooth_lanes
from tests.factories.repair_scenes import chain, queue


def test_smooth_lanes_reduces_noise_and_keeps_bends():
    angle = np.linspace(0, 1, 20)
    scene = chain(0.0)
    scene.lanes[0, :, :2] = 30 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1)
    np.testing.assert_array_equal(smooth_lanes(scene).lanes, scene.lanes)
    wavy = scene.replace(lanes=scene.lanes + np.random.default_rng(0).normal(0, 0.3, (3, 20, 3)).astype(np.float32))
    smooth = smooth_lanes(wavy)
    assert mean_turn(smooth) < 0.3 * mean_turn(wavy)
    assert np.square(smooth.lanes - scene.lanes).mean() < 0.7 * np.square(wavy.lanes - scene.lanes).mean()
    np.testing.assert_array_equal(smooth_lanes(wavy, known=2).lanes[:2], wavy.lanes[:2])


def mean_turn(scene: Scene) -> float:
    """Mean turn from one step of a lane to the next [rad]."""
    step = np.diff(scene.lanes[..., :2], axis=1)
    heading = np.arctan2(step[..., 1], step[..., 0])
    return float(np.abs((np.diff(heading, axis=1) + np.pi) % (2 * np.pi) - np.pi).mean())


def test_close_connections_meets_in_the_middle():
    scene = chain(1.0)
    connected = close_connections(scene)
    np.testing.assert_allclose(connection_gaps(connected), 0, atol=1e-6)
    np.testing.assert_allclose(connected.lanes[0, -1], [10, 0.5, 0], atol=1e-6)
    np.testing.assert_allclose(connected.lanes[0, 0], scene.lanes[0, 0])  # a free end
    steps = np.linalg.norm(np.diff(connected.lanes[..., :2], axis=1), axis=-1)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[:, :1], steps.shape), rtol=1e-4)
    np.testing.assert_array_equal(connected.links, scene.links)


def test_close_connections_fork_meets_in_one_point():
    scene = chain(0.8)
    scene.lanes[2, :, 0] -= 10  # the first lane leads into both others
    scene.links[:] = np.diag([Link.SELF] * 3)
    scene.links[0, 1:], scene.links[1:, 0] = Link.PREDECESSOR, Link.SUCCESSOR
    connected = close_connections(scene)
    np.testing.assert_allclose(
        connected.lanes[0, -1], (scene.lanes[0, -1] + scene.lanes[1, 0] + scene.lanes[2, 0]) / 3, rtol=1e-5
    )
    np.testing.assert_array_equal(connected.lanes[1, 0], connected.lanes[0, -1])
    np.testing.assert_array_equal(connected.lanes[2, 0], connected.lanes[0, -1])


def test_close_connections_removes_wide_links():
    connected = close_connections(chain(6.0))
    np.testing.assert_array_equal(connected.links, np.diag([Link.SELF] * 3))
    np.testing.assert_array_equal(connected.lanes, chain(6.0).lanes)


def test_close_connections_keeps_loop_length():
    scene = chain(0.0, lanes=1)
    scene.links[0, 0] = Link.PREDECESSOR  # leads into itself
    scene.lanes[0, :, 0] *= 0.3
    np.testing.assert_array_equal(close_connections(scene).lanes, scene.lanes)


def test_close_connections_does_not_fold_lanes():
    scene = chain(0.5)  # three lanes of 10 m, one after the other
    scene.lanes[1, :, 0] = 10 + 0.2 * (scene.lanes[1, :, 0] - 10)  # the second one has 2 m,
    scene.lanes[2, :, 0] -= 8
    scene.links[0, 2], scene.links[2, 0] = Link.PREDECESSOR, Link.SUCCESSOR  # which this link leaves out
    np.testing.assert_allclose(sorted(connection_gaps(scene)), [0.5, 0.5, np.hypot(2, 1)], rtol=1e-5)
    connected = close_connections(scene)
    np.testing.assert_allclose(connection_gaps(connected), 0, atol=1e-6)
    assert connected.links[0, 2] == connected.links[2, 0] == Link.NONE
    assert connected.links[0, 1] == connected.links[1, 2] == Link.PREDECESSOR
    length = np.linalg.norm(np.diff(connected.lanes[..., :2], axis=1), axis=-1).sum(-1)
    np.testing.assert_allclose(length, [10, 2, 10], atol=0.2)


def test_close_connections_moves_to_known_lanes():
    scene = chain(1.0)
    connected = close_connections(scene, known=1)
    np.testing.assert_array_equal(connected.lanes[0], scene.lanes[0])
    np.testing.assert_allclose(connected.lanes[1, 0], scene.lanes[0, -1], atol=1e-6)


@pytest.mark.parametrize("gap", [-0.5, -1.5])
def test_separate_boxes_moves_along_heading(gap):
    scene = queue(gap)
    separated = separate_boxes(scene)
    assert len(overlapping_pairs(scene)) and not len(overlapping_pairs(separated))
    np.testing.assert_array_equal(separated.agents[0], scene.agents[0])
    np.testing.assert_array_equal(separated.agents[:, 1:], scene.agents[:, 1:])


def test_separate_boxes_keeps_known_agents():
    scene = queue(-1.0)
    separated = separate_boxes(scene, known=3)
    np.testing.assert_array_equal(separated.agents[:3], scene.agents[:3])
    assert separated.agents[3, 0] != scene.agents[3, 0]


def test_repair_leaves_sound_scenes_bit_equal():
    for scene in (chain(0.0), queue(1.0)):
        repaired = repair(scene)
        for name, value in scene.to_dict().items():
            np.testing.assert_array_equal(getattr(repaired, name), value)


def test_repair_of_padded_batch_equals_single_scenes():
    broken = [chain(1.0), queue(-1.0)]
    batch = repair(stack([pad(scene, 6, 5) for scene in broken]))
    for i, scene in enumerate(broken):
        alone = pad(repair(scene), 6, 5)
        np.testing.assert_array_equal(batch[i].agents, alone.agents)
        np.testing.assert_array_equal(batch[i].lanes, alone.lanes)
