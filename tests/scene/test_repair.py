"""Repairs: lanes smooth, joints close, boxes part, and what is in order, known or padding does not move."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.metrics.realism import connection_gaps, overlapping_pairs
from scjax.scene import AgentType, Link, Scene, empty, pad, stack
from scjax.scene.repair import join_lanes, repair, separate, smooth_lanes


def chain(gap: float, lanes: int = 3) -> Scene:
    """Lanes of 10 m in a row along x; every joint is open by ``gap`` sideways."""
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
    """Cars of 4 m along x, ``gap`` between their boxes; the ego first."""
    scene = empty(cars, 1)
    scene.agents[:] = (0, 0, 0, 3, 1, 0, 4, 2, 1.5)
    scene.agents[:, 0] = np.arange(cars) * (4 + gap)
    scene.agent_types[:] = AgentType.VEHICLE
    scene.agent_mask[:] = scene.agent_known[:] = True
    return scene


def test_trembling_lanes_become_smooth_and_even_bends_stay():
    angle = np.linspace(0, 1, 20)
    scene = chain(0.0)
    scene.lanes[0, :, :2] = 30 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1)
    np.testing.assert_array_equal(smooth_lanes(scene).lanes, scene.lanes)
    wavy = scene.replace(lanes=scene.lanes + np.random.default_rng(0).normal(0, 0.3, (3, 20, 3)).astype(np.float32))
    smooth = smooth_lanes(wavy)
    assert bends(smooth) < 0.3 * bends(wavy)
    assert np.square(smooth.lanes - scene.lanes).mean() < 0.7 * np.square(wavy.lanes - scene.lanes).mean()
    np.testing.assert_array_equal(smooth_lanes(wavy, known=2).lanes[:2], wavy.lanes[:2])


def bends(scene: Scene) -> float:
    """Mean turn from one step of a lane to the next [rad]."""
    step = np.diff(scene.lanes[..., :2], axis=1)
    heading = np.arctan2(step[..., 1], step[..., 0])
    return float(np.abs((np.diff(heading, axis=1) + np.pi) % (2 * np.pi) - np.pi).mean())


def test_joints_close_in_the_middle_and_lanes_follow():
    scene = chain(1.0)
    joined = join_lanes(scene)
    np.testing.assert_allclose(connection_gaps(joined), 0, atol=1e-6)
    np.testing.assert_allclose(joined.lanes[0, -1], [10, 0.5, 0], atol=1e-6)
    np.testing.assert_allclose(joined.lanes[0, 0], scene.lanes[0, 0])  # a free end
    steps = np.linalg.norm(np.diff(joined.lanes[..., :2], axis=1), axis=-1)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[:, :1], steps.shape), rtol=1e-4)
    np.testing.assert_array_equal(joined.links, scene.links)


def test_forks_meet_in_one_point():
    scene = chain(0.8)
    scene.lanes[2, :, 0] -= 10  # the first lane leads into both others
    scene.links[:] = np.diag([Link.SELF] * 3)
    scene.links[0, 1:], scene.links[1:, 0] = Link.PREDECESSOR, Link.SUCCESSOR
    joined = join_lanes(scene)
    np.testing.assert_allclose(
        joined.lanes[0, -1], (scene.lanes[0, -1] + scene.lanes[1, 0] + scene.lanes[2, 0]) / 3, rtol=1e-5
    )
    np.testing.assert_array_equal(joined.lanes[1, 0], joined.lanes[0, -1])
    np.testing.assert_array_equal(joined.lanes[2, 0], joined.lanes[0, -1])


def test_a_link_over_a_wide_gap_goes():
    joined = join_lanes(chain(6.0))
    np.testing.assert_array_equal(joined.links, np.diag([Link.SELF] * 3))
    np.testing.assert_array_equal(joined.lanes, chain(6.0).lanes)


def test_a_loop_keeps_its_length():
    scene = chain(0.0, lanes=1)
    scene.links[0, 0] = Link.PREDECESSOR  # leads into itself
    scene.lanes[0, :, 0] *= 0.3
    np.testing.assert_array_equal(join_lanes(scene).lanes, scene.lanes)


def test_of_joints_that_would_fold_a_lane_the_widest_goes():
    scene = chain(0.5)  # three lanes of 10 m, one after the other
    scene.lanes[1, :, 0] = 10 + 0.2 * (scene.lanes[1, :, 0] - 10)  # the second one has 2 m,
    scene.lanes[2, :, 0] -= 8
    scene.links[0, 2], scene.links[2, 0] = Link.PREDECESSOR, Link.SUCCESSOR  # which this link leaves out
    np.testing.assert_allclose(sorted(connection_gaps(scene)), [0.5, 0.5, np.hypot(2, 1)], rtol=1e-5)
    joined = join_lanes(scene)
    np.testing.assert_allclose(connection_gaps(joined), 0, atol=1e-6)
    assert joined.links[0, 2] == joined.links[2, 0] == Link.NONE
    assert joined.links[0, 1] == joined.links[1, 2] == Link.PREDECESSOR
    length = np.linalg.norm(np.diff(joined.lanes[..., :2], axis=1), axis=-1).sum(-1)
    np.testing.assert_allclose(length, [10, 2, 10], atol=0.2)


def test_known_lanes_pull_the_others():
    scene = chain(1.0)
    joined = join_lanes(scene, known=1)
    np.testing.assert_array_equal(joined.lanes[0], scene.lanes[0])
    np.testing.assert_allclose(joined.lanes[1, 0], scene.lanes[0, -1], atol=1e-6)


@pytest.mark.parametrize("gap", [-0.5, -1.5])
def test_boxes_part_along_their_heading(gap):
    scene = queue(gap)
    parted = separate(scene)
    assert len(overlapping_pairs(scene)) and not len(overlapping_pairs(parted))
    np.testing.assert_array_equal(parted.agents[0], scene.agents[0])
    np.testing.assert_array_equal(parted.agents[:, 1:], scene.agents[:, 1:])


def test_known_agents_do_not_move_even_where_they_overlap():
    scene = queue(-1.0)
    parted = separate(scene, known=3)
    np.testing.assert_array_equal(parted.agents[:3], scene.agents[:3])
    assert parted.agents[3, 0] != scene.agents[3, 0]


def test_scenes_in_order_come_back_bit_equal_alone_and_in_a_padded_batch():
    scenes = [chain(0.0), queue(1.0)]
    for before, after in zip(scenes, map(repair, scenes), strict=True):
        for name, value in before.to_dict().items():
            np.testing.assert_array_equal(getattr(after, name), value)
    broken = [chain(1.0), queue(-1.0)]
    batch = repair(stack([pad(scene, 6, 5) for scene in broken]))
    for i, scene in enumerate(broken):
        alone = pad(repair(scene), 6, 5)
        np.testing.assert_array_equal(batch[i].agents, alone.agents)
        np.testing.assert_array_equal(batch[i].lanes, alone.lanes)
