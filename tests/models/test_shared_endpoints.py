"""Linked lane ends become one point; free, fixed and padded lanes do not move; a node never folds a lane."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.metrics.realism import connection_gaps
from scjax.models.shared_endpoints import share_endpoints
from scjax.scene import Link, Scene, pad, stack, unpadded
from tests.factories.repair_scenes import chain

_share = jax.jit(share_endpoints)


def share(*scenes: Scene, lanes: int = 6, **options) -> list[Scene]:
    """The scenes as one padded batch with shared endpoints, unpadded."""
    result = _share(stack([pad(scene, 1, lanes) for scene in scenes]), **options).to_numpy()
    return [unpadded(result[i]) for i in range(len(scenes))]


def link(scene: Scene, first: int, second: int) -> None:
    scene.links[first, second], scene.links[second, first] = Link.PREDECESSOR, Link.SUCCESSOR


def fork(gap: float) -> Scene:
    """A lane that leads into two others, of which the second link of one is missing."""
    scene = chain(gap)
    scene.lanes[2, :, 0] -= 10
    scene.links[:] = np.diag([Link.SELF] * 3)
    link(scene, 0, 1)
    link(scene, 0, 2)
    return scene


@pytest.mark.parametrize("scene", [chain(1.0), chain(0.4, lanes=6), fork(0.8)])
def test_linked_ends_are_equal_bit_for_bit(scene):
    rng = np.random.default_rng(0)
    scene = scene.replace(lanes=scene.lanes + rng.normal(0, 0.3, scene.lanes.shape).astype(np.float32))
    (closed,) = share(scene)
    before, after = np.argwhere(scene.links == Link.PREDECESSOR).T
    np.testing.assert_array_equal(closed.lanes[before, -1], closed.lanes[after, 0])
    assert connection_gaps(scene).max() > 0.1
    np.testing.assert_array_equal(closed.links, scene.links)


def test_node_is_the_mean_of_all_its_ends():
    scene = fork(0.8)
    (closed,) = share(scene)
    mean = (scene.lanes[0, -1] + scene.lanes[1, 0] + scene.lanes[2, 0]) / 3
    np.testing.assert_allclose(closed.lanes[0, -1], mean, atol=1e-6)


def test_ends_that_are_joined_by_way_of_others_are_one_node():
    """Lane 0 leads into 1 and lane 2 too, but 2 also into 3: the link from 0 to 3 is missing."""
    scene = chain(0.2, lanes=4)
    for lane, x in enumerate((0, 10, 0, 10)):
        scene.lanes[lane, :, 0] = x + np.linspace(0, 10, 20)
    scene.links[:] = np.diag([Link.SELF] * 4)
    for pair in ((0, 1), (2, 1), (2, 3)):
        link(scene, *pair)
    (closed,) = share(scene)
    node = closed.lanes[0, -1]
    np.testing.assert_array_equal([closed.lanes[1, 0], closed.lanes[2, -1], closed.lanes[3, 0]], [node] * 3)


@pytest.mark.parametrize("beside", [1.2, 3.0])
def test_link_to_the_lane_beside_goes_where_another_lane_leads_there(beside):
    """Two lanes beside each other, each followed by another; the first also leads into the lane after the second."""
    scene = chain(0.2, lanes=4)
    for lane, (x, y) in enumerate(((0, 0), (10, 0), (0, beside), (10, beside))):
        scene.lanes[lane, :, 0], scene.lanes[lane, :, 1] = x + np.linspace(0, 10, 20), y
    scene.links[:] = np.diag([Link.SELF] * 4)
    for pair in ((0, 1), (2, 3), (0, 3)):
        link(scene, *pair)
    (closed,) = share(scene)
    assert (closed.links[0, 3] == Link.NONE) == (beside == 3.0)
    np.testing.assert_allclose(closed.lanes[1, 0, 1], 0 if beside == 3.0 else beside / 2, atol=1e-6)
    (alone,) = share(scene.replace(links=np.where(np.eye(4) == 1, scene.links, 0) + _only(scene.links, 0, 3)))
    assert alone.links[0, 3] == Link.PREDECESSOR  # the only link of both


def _only(links: np.ndarray, first: int, second: int) -> np.ndarray:
    kept = np.zeros_like(links)
    kept[first, second], kept[second, first] = links[first, second], links[second, first]
    return kept


def test_moves_fade_along_the_lane_and_keep_its_heading_at_both_ends():
    scene = chain(1.0)
    (closed,) = share(scene)
    move = (closed.lanes - scene.lanes)[0, :, 1]  # the first lane's end moves by 0.5 m to the left
    assert np.all(np.diff(move) >= 0) and move[0] == 0 and move[-1] == 0.5
    assert max(move[1], move[-1] - move[-2]) < 0.005 < np.diff(move).max() < 0.04


def test_sharing_twice_is_sharing_once():
    (once,) = share(fork(0.8))
    (twice,) = share(once)
    np.testing.assert_allclose(twice.lanes, once.lanes, atol=1e-5)


def test_padding_and_batch_change_nothing():
    few, many = chain(1.0), chain(0.4, lanes=6)
    alone, together = share(few, lanes=3)[0], share(many, few)[1]
    np.testing.assert_allclose(together.lanes, alone.lanes, atol=1e-6)
    batch = stack([pad(few, 1, 6)])
    spoilt = batch.replace(lanes=np.where(batch.lane_mask[..., None, None], batch.lanes, np.nan))
    np.testing.assert_array_equal(_share(spoilt).lanes[0, :3], _share(batch).lanes[0, :3])


def test_fixed_lanes_stay_and_others_end_there():
    scene = chain(1.0)
    fixed = np.zeros((1, 6), bool)
    fixed[0, 1] = True
    (closed,) = share(scene, fixed=fixed)
    np.testing.assert_array_equal(closed.lanes[1], scene.lanes[1])
    np.testing.assert_array_equal(closed.lanes[0, -1], scene.lanes[1, 0])
    np.testing.assert_array_equal(closed.lanes[2, 0], scene.lanes[1, -1])


def test_wide_links_are_removed():
    (opened,) = share(chain(6.0))
    np.testing.assert_array_equal(opened.links, np.diag([Link.SELF] * 3))
    np.testing.assert_array_equal(opened.lanes, chain(6.0).lanes)


def test_a_lane_is_not_folded():
    """As in the repair: of the links that join both ends of a lane of 2 m, the one that leaves it out goes."""
    scene = chain(0.5)
    scene.lanes[1, :, 0] = 10 + 0.2 * (scene.lanes[1, :, 0] - 10)
    scene.lanes[2, :, 0] -= 8
    link(scene, 0, 2)
    (closed,) = share(scene)
    assert closed.links[0, 2] == closed.links[2, 0] == Link.NONE
    assert closed.links[0, 1] == closed.links[1, 2] == Link.PREDECESSOR
    np.testing.assert_array_equal(closed.lanes[0, -1], closed.lanes[1, 0])
    assert np.linalg.norm(closed.lanes[1, -1] - closed.lanes[1, 0]) > 1.9


def test_a_lane_that_leads_into_itself_stays():
    scene = chain(0.0, lanes=1)
    scene.lanes[0, :, 0] *= 0.3
    scene.links[0, 0] = Link.PREDECESSOR
    (closed,) = share(scene)
    np.testing.assert_array_equal(closed.lanes, scene.lanes)


def test_every_end_of_a_node_gets_its_share_of_the_gradient():
    batch = stack([pad(fork(0.8), 1, 6)])

    @jax.jit
    def node(lanes):
        return share_endpoints(batch.replace(lanes=lanes)).lanes[0, 0, -1, 1]

    gradient = np.asarray(jax.grad(node)(jnp.asarray(batch.lanes)))[0, ..., 1]
    np.testing.assert_allclose([gradient[0, -1], gradient[1, 0], gradient[2, 0]], 1 / 3, rtol=1e-5)
    assert np.isfinite(gradient).all() and abs(gradient.sum() - 1) < 1e-5
