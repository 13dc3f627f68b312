"""Distance between lane graphs: a metric's properties, closed forms, and the search against brute force."""

import numpy as np
import pytest

from scjax.metrics.alignment import LARGEST_SHIFT, LARGEST_TURN, register, transform_points
from scjax.metrics.novelty import DIRECTION, lane_distance, lane_points, nearest_tiles
from scjax.scene import geometry, pad, permute
from tests.factories.traffic import agent, crossing, eval_tiles, lane, scene

EGO = [agent(0, 0)]


def road(shift: float = 0.0, *, back: bool = False):
    ends = ((-20, shift), (20, shift))
    return scene(EGO, [lane(*(ends[::-1] if back else ends))])


def test_lane_points_are_two_metres_apart():
    points = lane_points(pad(scene(EGO, [lane((0, 0), (10, 0)), lane((0, 0), (0, 0.7))]), 3, 5))
    assert points.shape == (6, 4)
    np.testing.assert_allclose(points[:5, 0], [1, 3, 5, 7, 9], atol=1e-5)
    np.testing.assert_allclose(points[5], [0, 0.35, 0, DIRECTION], atol=1e-6)


def test_lane_points_are_bounded():
    rng = np.random.default_rng(0)
    wild = scene(EGO, list(rng.uniform(-900, 900, (10, 20, 3)).astype(np.float32)))
    assert len(lane_points(wild)) == pytest.approx(2000, abs=10)


def test_lane_distance_has_its_closed_forms():
    assert lane_distance(road(), road()) == 0
    assert lane_distance(road(), road(1.5)) == pytest.approx(1.5)
    assert lane_distance(road(), road(back=True)) == pytest.approx(2 * DIRECTION)
    assert lane_distance(road(), road(3, back=True)) == pytest.approx(5)
    # One lane more on one side: only that side's mean sees it.
    both = scene(EGO, [*road().lanes, *road(4).lanes])
    assert lane_distance(road(), both) == lane_distance(both, road()) == pytest.approx((0 + (0 + 4) / 2) / 2)


def test_lane_distance_ignores_order_and_padding():
    original = crossing()
    other = pad(permute(original, np.arange(4), np.array([2, 0, 1])), 9, 9)
    assert lane_distance(original, other) == pytest.approx(0, abs=1e-6)


def test_lane_distance_without_lanes():
    bare = scene(EGO)
    assert lane_distance(bare, bare) == 0 and lane_distance(bare, road()) == np.inf
    nearest = list(nearest_tiles([bare, road(0.5)], [road(), bare]))
    assert [near.tile for near, _ in nearest] == [1, 0] and [near.lane_distance for near, _ in nearest] == [0, 0.5]
    with pytest.raises(ValueError, match="bank is empty"):
        next(nearest_tiles([bare], []))


def test_nearest_tiles_match_the_nearest_tile():
    near = scene([*EGO, agent(9, 0)], [lane((-20, 0), (20, 0))])
    far = scene([*EGO, agent(5, 0)], [lane((0, 9), (9, 9))])
    ((nearest, _),) = nearest_tiles(scene([*EGO, agent(9.5, 0), agent(5, 0)], [lane((-20, 1), (20, 1))]), [far, near])
    assert nearest.tile == 1 and nearest.match["recall_1m"] == (1, 1) and nearest.match["precision_1m"] == (1, 2)


def turned(original, pose):
    """The scene moved by x, y [m] and yaw [rad]."""
    return geometry.move(original, np.array(pose, np.float32)).to_numpy()


def test_nearest_tiles_align_moved_copies():
    rng = np.random.default_rng(0)
    bank = [crossing(), road(1)]
    bank += [scene(EGO, [lane(*rng.uniform(-32, 32, (2, 2))) for _ in range(3)]) for _ in range(30)]
    for pose in ((1.5, -2, 0.15), (-2, 1, -0.17), (0, 0, 0)):
        ((plain, aligned),) = nearest_tiles(turned(crossing(), pose), bank)
        assert aligned.tile == 0 and aligned.lane_distance < 0.05
        np.testing.assert_allclose(
            transform_points(transform_points(np.zeros((1, 2)), np.array(pose, np.float64)), aligned.pose), 0, atol=0.05
        )
        assert aligned.match["recall_1m"] == (3, 3)
        assert pose == (0, 0, 0) or plain.lane_distance > 0.5


def test_register_stays_within_its_limits():
    original = crossing()
    points, target = lane_points(original), lane_points(turned(original, (9, 9, 0.6)))
    pose = register(points, target, np.zeros(3), 20)
    assert np.hypot(*pose[:2]) <= LARGEST_SHIFT + 1e-9 and abs(pose[2]) <= LARGEST_TURN + 1e-9


def test_nearest_tiles_equal_brute_force():
    rng = np.random.default_rng(0)

    def tile():
        return scene(EGO, [lane(*rng.uniform(-32, 32, (2, 2))) for _ in range(rng.integers(1, 5))])

    bank, queries = [tile() for _ in range(40)], [tile() for _ in range(10)]
    for query, (nearest, aligned) in zip(queries, nearest_tiles(queries, bank), strict=True):
        exact = [lane_distance(query, other) for other in bank]
        assert nearest.tile == np.argmin(exact) and nearest.lane_distance == min(exact)
        assert aligned.lane_distance <= nearest.lane_distance


def test_golden_tiles_find_themselves(eval_dir):
    bank = eval_tiles(eval_dir, "train", only=list(range(0, 1239, 4)))
    nearest = list(nearest_tiles(bank[::60], bank))
    assert [near.lane_distance for near, _ in nearest] == [0.0] * len(nearest)  # several tiles may hold the same lanes
    peers = eval_tiles(eval_dir, "peer_vehicle", only=[0, 100, 200])
    for peer, (near, _) in zip(peers, nearest_tiles(peers, bank), strict=True):
        assert 0 < near.lane_distance < 10
        assert near.lane_distance == lane_distance(peer, bank[near.tile])
