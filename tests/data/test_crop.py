import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.data.crop import crop_scene
from scjax.data.local_map import LocalMap
from scjax.scene import AgentType, Crop, Link, Signal, pad, validate


def local_map(lanes, successors=(), neighbors=(), overlap_spans=(), agents=(), types=None, off_road=None) -> LocalMap:
    """A local map from lists; agents are (x, y)."""
    lanes = [np.asarray(line, float) for line in lanes]
    states = np.zeros((len(agents) + 1, 9))
    states[1:, :2] = np.reshape(agents, (-1, 2))
    states[:, 4], states[:, 6:] = 1.0, (4.0, 2.0, 1.5)
    count = len(states)
    return LocalMap(
        points=np.concatenate(lanes),
        offsets=np.concatenate([[0], np.cumsum([len(line) for line in lanes])]),
        lane_z_known=np.ones(len(lanes), bool),
        successors=np.reshape(successors, (-1, 2)).astype(int),
        neighbors=np.reshape(neighbors, (-1, 2)).astype(int),
        overlap_spans=np.reshape(overlap_spans, (-1, 4)).astype(float),
        signals=np.arange(len(lanes)) % 4,
        agents=states,
        agent_types=np.zeros(count, int) if types is None else np.array([0, *types]),
        agent_known=np.ones((count, 9), bool),
        off_road=np.zeros(count, bool) if off_road is None else np.array([False, *off_road]),
    )


def straight(*points):
    return [(*p, 0.0) for p in points]


def starts(scene):
    return [tuple(np.round(lane[0, :2].astype(float), 3)) for lane in scene.lanes]


def test_crop_lanes_by_distance_with_signals():
    lanes = [straight((-40, 9), (40, 9)), straight((-9, 1), (9, 1)), straight((50, 0), (70, 0))]
    scene = validate(crop_scene(local_map(lanes)))
    assert starts(scene) == [(-9, 1), (-32, 9)]
    assert scene.signals.tolist() == [Signal.GO, Signal.UNKNOWN]
    np.testing.assert_allclose(np.diff(scene.lanes[1, :, 0]), 64 / 19, rtol=1e-5)


def test_crop_links_need_true_ends():
    lanes = [straight((-9, 0), (0, 0)), straight((0, 0), (9, 3)), straight((0, 0), (40, 0)), straight((40, 0), (20, 9))]
    scene = validate(crop_scene(local_map(lanes, successors=[(0, 1), (0, 2), (2, 3)])))
    rank = {start: i for i, start in enumerate(map(tuple, scene.lanes[:, -1, :2].astype(float).round(3)))}
    first, fork, ahead, last = (rank[end] for end in ((0, 0), (9, 3), (32, 0), (20, 9)))
    assert scene.links[first, fork] == scene.links[first, ahead] == Link.PREDECESSOR
    assert scene.links[fork, first] == Link.SUCCESSOR
    assert scene.links[ahead, last] == Link.NONE  # the join lies outside the window


def test_crop_partitioned_cuts_and_links_lanes():
    weave = [straight((-20, 5), (10, 5)) + straight((10, 9), (-10, 9), (-10, 12), (20, 12))]
    scene = validate(crop_scene(local_map(weave), Crop.PARTITIONED))
    assert scene.crop == Crop.PARTITIONED and len(scene.lanes) == 4
    x = scene.lanes[..., 0]
    assert ((x <= 0).all(1) | (x >= 0).all(1)).all()
    chain = scene.links == Link.PREDECESSOR
    assert chain.sum() == 3
    for i, j in np.argwhere(chain):
        np.testing.assert_allclose(scene.lanes[i, -1], scene.lanes[j, 0])
        assert abs(scene.lanes[i, -1, 0]) == 0


def test_crop_forward_starts_at_ego():
    lanes = [straight((-70, 0), (70, 0)), straight((-9, 5), (-1, 5))]
    scene = validate(crop_scene(local_map(lanes, agents=[(-1, 0), (60, 0), (40, 0)]), Crop.FORWARD))
    np.testing.assert_allclose(scene.lanes[0, [0, -1], 0], [0, 64])
    assert len(scene.lanes) == 1
    np.testing.assert_allclose(scene.agents[:, 0], [0, 60, 40])  # kept in the order of the local map


def test_crop_neighbors_follow_pieces():
    right = straight((-40, 0), (40, 0))
    left = straight((-40, 3), (-10, 3), (-10, 40), (10, 40), (10, 3), (40, 3))  # leaves the window and comes back
    # Side by side only up to x = -10: arc 0..30 of both.
    scene = validate(crop_scene(local_map([right, left], neighbors=[(1, 0)], overlap_spans=[(0, 30, 0, 30)])))
    middle = next(i for i, lane in enumerate(scene.lanes) if np.ptp(lane[:, 1]) == 0)
    assert len(scene.lanes) == 3 and (scene.links == Link.LEFT).sum() == 1
    entering = next(i for i, lane in enumerate(scene.lanes) if i != middle and lane[0, 0] < -30)
    assert scene.links[entering, middle] == Link.LEFT and scene.links[middle, entering] == Link.RIGHT

    cut = validate(
        crop_scene(local_map([right, left], neighbors=[(1, 0)], overlap_spans=[(0, 30, 0, 30)]), Crop.PARTITIONED)
    )
    before = (cut.lanes[..., 0] <= 0).all(1)
    i, j = np.argwhere(cut.links == Link.LEFT)[0]
    assert (cut.links == Link.LEFT).sum() == 1 and before[i] and before[j]


def test_crop_keeps_nearest_within_limits():
    lanes = [straight((-9, y), (9, y)) for y in range(1, 21)]
    successors = [(i, i + 1) for i in range(19)]
    agents = [(x, 0) for x in range(1, 21)]
    scene = validate(crop_scene(local_map(lanes, successors, agents=agents), max_lanes=6, max_agents=4))
    assert [y for _, y in starts(scene)] == [1, 2, 3, 4, 5, 6]
    assert scene.agents[:, 0].tolist() == [0, 1, 2, 3]
    assert scene.links.shape == (6, 6)
    validate(pad(scene, 61, 100))


def test_crop_parked_vehicles_are_optional():
    scene_map = local_map(
        [straight((-9, 0), (9, 0))], agents=[(3, 0), (5, 0)], types=[0, int(AgentType.STATIC)], off_road=[True, False]
    )
    assert crop_scene(scene_map).agent_types.tolist() == [0, AgentType.STATIC]
    assert len(crop_scene(scene_map, off_road=True).agents) == 3


def test_crop_flags_unknown_elevation():
    scene_map = dataclasses.replace(local_map([straight((-9, 0), (9, 0))]), lane_z_known=np.array([False]))
    assert crop_scene(scene_map).lane_known.tolist() == [[True, True, False]]


def test_crop_without_lanes_keeps_ego():
    scene = validate(crop_scene(local_map([straight((50, 0), (60, 0))])))
    assert scene.lanes.shape == (0, 20, 3) and scene.links.shape == (0, 0) and len(scene.agents) == 1


@given(st.integers(0, 2**32 - 1), st.sampled_from(list(Crop)))
@settings(max_examples=60, deadline=None)
def test_crop_moved_window_equals_moved_world(seed, crop):
    rng = np.random.default_rng(seed)
    lanes = [np.cumsum(rng.normal(0, 6, (12, 3)) * [1, 1, 0.1], 0) + rng.uniform(-30, 30, 3) for _ in range(5)]
    agents = rng.uniform(-40, 40, (10, 2))
    successors = rng.integers(0, 5, (4, 2))
    scene_map = local_map(lanes, successors, agents=agents)
    dx, dy, dyaw = *rng.uniform(-5, 5, 2), rng.uniform(-3, 3)
    cos, sin = np.cos(dyaw), np.sin(dyaw)
    turn = np.array([[cos, -sin], [sin, cos]])
    moved = scene_map.agents.copy()
    moved[:, :2] = (moved[:, :2] - (dx, dy)) @ turn
    moved[:, 4:6] = moved[:, 4:6] @ turn
    points = scene_map.points.copy()
    points[:, :2] = (points[:, :2] - (dx, dy)) @ turn
    order = np.argsort(np.r_[-1.0, np.hypot(*moved[1:, :2].T)])
    world = dataclasses.replace(scene_map, points=points, agents=moved[order])
    actual, expected = crop_scene(scene_map, crop, dx=dx, dy=dy, dyaw=dyaw), crop_scene(world, crop)
    validate(actual)
    np.testing.assert_allclose(actual.lanes, expected.lanes, atol=1e-4)
    np.testing.assert_allclose(actual.agents, expected.agents, atol=1e-4)
    np.testing.assert_array_equal(actual.links, expected.links)
    x_low, x_high = (0, 64) if crop == Crop.FORWARD else (-32, 32)
    inside = (actual.agents[1:, 0] >= x_low) & (actual.agents[1:, 0] <= x_high) & (np.abs(actual.agents[1:, 1]) <= 32)
    assert inside.all() and np.abs(np.hypot(actual.agents[:, 4], actual.agents[:, 5]) - 1).max() < 1e-6


@pytest.mark.parametrize("crop", list(Crop))
def test_crop_accepts_float32(crop):
    scene_map = local_map([straight((-70, 1), (70, 1))])
    scene_map = dataclasses.replace(
        scene_map, points=scene_map.points.astype(np.float32), offsets=scene_map.offsets.astype(np.int32)
    )
    scene = validate(crop_scene(scene_map, crop))
    assert scene.lanes.dtype == np.float32 and scene.links.dtype == np.int32
