"""Frames, polylines and boxes against shapely and SciPy-free NumPy, with masks, batches and gradients."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
import shapely.affinity

from scjax.scene import geometry, validate
from tests.factories.examples import example_batch, example_scene

RNG = np.random.default_rng(0)


def _poses(*shape: int) -> np.ndarray:
    return RNG.uniform(-3, 3, (*shape, 3)).astype(np.float32) * np.array([10, 10, 1], np.float32)


def _rotations(*shape: int) -> np.ndarray:
    return np.asarray(geometry.matrix_from_quaternion(RNG.normal(size=(*shape, 4)).astype(np.float32)))


def test_wrap_angle():
    angles = np.array([0, np.pi, -np.pi, 3 * np.pi / 2, -7, 100], np.float32)
    wrapped = np.asarray(geometry.wrap_angle(angles))
    assert (wrapped > -np.pi - 1e-6).all() and (wrapped <= np.pi + 1e-6).all()
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angles), atol=2e-5)
    assert wrapped[2] == pytest.approx(np.pi, abs=1e-6)
    assert jax.grad(geometry.wrap_angle)(4.0) == pytest.approx(1)


def test_se2_apply_agrees_with_complex_numbers():
    pose, points = _poses(5), RNG.normal(size=(5, 7, 4, 2)).astype(np.float32)
    moved = np.asarray(geometry.se2_apply(pose, points))
    turned = (points[..., 0] + 1j * points[..., 1]) * np.exp(1j * pose[:, 2])[:, None, None]
    np.testing.assert_allclose(
        moved[..., 0] + 1j * moved[..., 1], turned + (pose[:, 0] + 1j * pose[:, 1])[:, None, None], atol=1e-5
    )


def test_se2_inverse_and_compose():
    first, second = _poses(2, 3), _poses(2, 3)
    points = RNG.normal(size=(2, 3, 6, 2)).astype(np.float32)
    both = geometry.se2_apply(geometry.se2_compose(first, second), points)
    np.testing.assert_allclose(both, geometry.se2_apply(first, geometry.se2_apply(second, points)), atol=2e-5)
    np.testing.assert_allclose(geometry.se2_compose(first, geometry.se2_inverse(first)), 0, atol=2e-5)


def test_se3_inverse_and_compose():
    first, second = ((_rotations(4), RNG.normal(size=(4, 3)).astype(np.float32)) for _ in range(2))
    points = RNG.normal(size=(4, 6, 3)).astype(np.float32)
    expected = np.einsum("bij,bnj->bni", first[0], points) + first[1][:, None]
    np.testing.assert_allclose(geometry.se3_apply(*first, points), expected, atol=1e-5)
    both = geometry.se3_apply(*geometry.se3_compose(first, second), points)
    np.testing.assert_allclose(both, geometry.se3_apply(*first, geometry.se3_apply(*second, points)), atol=1e-5)
    there_and_back = geometry.se3_apply(*geometry.se3_inverse(*first), geometry.se3_apply(*first, points))
    np.testing.assert_allclose(there_and_back, points, atol=1e-5)


def test_matrix_from_quaternion_is_a_rotation():
    matrices = _rotations(20)
    np.testing.assert_allclose(matrices @ matrices.swapaxes(-1, -2), np.eye(3) * np.ones((20, 1, 1)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(matrices), 1, atol=1e-5)
    # A quarter turn about z takes x to y, one about x takes y to z.
    quarters = geometry.matrix_from_quaternion(np.array([[3, 0, 0, 3], [1, 1, 0, 0]], np.float32))
    np.testing.assert_allclose(quarters[0, :, 0], [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(quarters[1, :, 1], [0, 0, 1], atol=1e-6)
    cos, sin = np.cos(0.3), np.sin(0.3)
    turn = geometry.matrix_from_yaw(np.array([0.3], np.float32))
    np.testing.assert_allclose(turn[0], [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]], atol=1e-6)


def test_move_there_and_back():
    batch, pose = example_batch(3), _poses(3)
    moved = geometry.move(batch, pose)
    validate(moved)
    for values, mask in ((moved.agents, batch.agent_mask), (moved.lanes, batch.lane_mask)):
        assert not np.asarray(values)[~mask].any()
    back = geometry.move(moved, geometry.se2_inverse(pose))
    np.testing.assert_allclose(back.agents, batch.agents, atol=2e-5)
    np.testing.assert_allclose(back.lanes, batch.lanes, atol=2e-5)
    single = geometry.move(batch[1], pose[1])
    np.testing.assert_allclose(moved[1].agents, single.agents, atol=1e-5)


def test_move_agent_to_its_own_frame():
    scene = example_scene()
    x, y, cos, sin = scene.agents[2, [0, 1, 4, 5]]
    seen = geometry.move(scene, geometry.se2_inverse(np.array([x, y, np.arctan2(sin, cos)])))
    np.testing.assert_allclose(seen.agents[2, jnp.array([0, 1, 4, 5])], [0, 0, 1, 0], atol=1e-5)
    np.testing.assert_array_equal(seen.agents[2, 6:], scene.agents[2, 6:])


def test_move_se3_equals_move_in_the_plane():
    batch, pose = example_batch(2), _poses(2)
    height = np.array([1.5, -2], np.float32)
    translation = np.concatenate([pose[:, :2], height[:, None]], -1)
    flat = geometry.move(batch, pose)
    spatial = geometry.move_se3(batch, geometry.matrix_from_yaw(pose[:, 2]), translation)
    lift = height[:, None] * batch.agent_mask
    np.testing.assert_allclose(spatial.agents, np.asarray(flat.agents.at[..., 2].add(lift)), atol=2e-5)
    np.testing.assert_allclose(spatial.lanes[..., :2], flat.lanes[..., :2], atol=2e-5)
    expected = batch.lanes[..., 2] + (height[:, None] * batch.lane_mask)[..., None]
    np.testing.assert_allclose(spatial.lanes[..., 2], expected, atol=2e-5)


def test_move_se3_tilts_lanes_and_keeps_unit_headings():
    scene = example_scene()
    # Nose up by 0.1 rad.
    pitch = geometry.matrix_from_quaternion(np.array([np.cos(0.05), 0, -np.sin(0.05), 0], np.float32))
    tilted = validate(geometry.move_se3(scene, pitch, np.zeros(3, np.float32)))
    expected = scene.lanes[0, :, 0] * np.sin(0.1) + scene.lanes[0, :, 2] * np.cos(0.1)
    np.testing.assert_allclose(tilted.lanes[0, :, 2], expected, atol=1e-5)


def test_arc_length_is_planar_and_masked():
    line = np.array([[0, 0, 0], [3, 4, 9], [3, 5, 0], [99, 99, 99]], np.float32)
    mask = np.array([True, True, True, False])
    np.testing.assert_allclose(geometry.arc_length(line, mask), [0, 5, 6, 6])
    np.testing.assert_allclose(geometry.arc_length(np.stack([line, line]))[1, :3], [0, 5, 6])


def test_resample_agrees_with_shapely():
    lines = np.cumsum(RNG.normal(size=(2, 3, 9, 2)), axis=2).astype(np.float32)
    length = RNG.integers(2, 10, (2, 3))
    mask = np.arange(9) < length[..., None]
    actual = np.asarray(geometry.resample(np.where(mask[..., None], lines, 1e3).astype(np.float32), 7, mask))
    for index in np.ndindex(2, 3):
        line = shapely.LineString(lines[index][: length[index]].astype(np.float64))
        expected = [line.interpolate(share, normalized=True).coords[0] for share in np.linspace(0, 1, 7)]
        np.testing.assert_allclose(actual[index], expected, atol=2e-5)


def test_resample_ends_z_and_degenerate_lines():
    line = np.array([[0, 0, 1], [1, 0, 2], [4, 0, 8]], np.float32)
    np.testing.assert_allclose(geometry.resample(line, 5), [[k, 0, max(1 + k, 2 * k)] for k in range(5)])
    point = np.full((3, 2), 2, np.float32)
    np.testing.assert_array_equal(geometry.resample(point, 4), np.full((4, 2), 2))
    alone = np.array([[1, 1], [np.inf, np.inf], [0, 0]], np.float32)
    np.testing.assert_array_equal(geometry.resample(alone, 3, np.array([True, False, False])), np.ones((3, 2)))


def test_distance_to_polylines_agrees_with_shapely():
    points = RNG.normal(size=(2, 5, 2)).astype(np.float32) * 3
    lines = np.cumsum(RNG.normal(size=(2, 4, 6, 2)), axis=2).astype(np.float32)
    lines[:, :, 3] = lines[:, :, 2]  # a segment of no length
    mask = np.array([[True, True, True, False]] * 2)
    actual = np.asarray(geometry.distance_to_polylines(points, lines, mask))
    assert np.isinf(actual[..., 3]).all()
    for b, i, k in np.ndindex(2, 5, 3):
        expected = shapely.LineString(lines[b, k].astype(np.float64)).distance(shapely.Point(points[b, i]))
        assert actual[b, i, k] == pytest.approx(expected, abs=1e-5)


def _boxes(*shape: int) -> np.ndarray:
    agents = np.zeros((*shape, 9), np.float32)
    heading = RNG.uniform(-np.pi, np.pi, shape)
    agents[..., :2] = RNG.uniform(-6, 6, (*shape, 2))
    agents[..., 4], agents[..., 5] = np.cos(heading), np.sin(heading)
    agents[..., 6:] = RNG.uniform(0.5, 5, (*shape, 3))
    return agents


def _polygon(agent: np.ndarray) -> shapely.Polygon:
    x, y, _, _, cos, sin, length, width, _ = agent.astype(np.float64)
    box = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    return shapely.affinity.translate(shapely.affinity.rotate(box, np.arctan2(sin, cos), (0, 0), True), x, y)


def test_box_corners_agree_with_shapely():
    agents = _boxes(6)
    corners = np.asarray(geometry.box_corners(agents))
    for agent, quad in zip(agents, corners, strict=True):
        actual = shapely.Polygon(quad)
        assert actual.exterior.is_ccw and actual.symmetric_difference(_polygon(agent)).area < 1e-3
    forward = corners[:, [0, 3]].mean(1) - agents[:, :2]
    np.testing.assert_allclose((forward * agents[:, 4:6]).sum(-1), agents[:, 6] / 2, atol=1e-5)


def test_box_penetration_agrees_with_shapely():
    agents = _boxes(3, 16)
    mask = RNG.uniform(size=(3, 16)) < 0.8
    overlap = np.asarray(geometry.boxes_overlap(agents, mask))
    depth = np.asarray(geometry.box_penetration(agents, mask))
    seen = set()
    for b, i, j in np.ndindex(3, 16, 16):
        first, second = _polygon(agents[b, i]), _polygon(agents[b, j])
        expected = bool(mask[b, i] and mask[b, j] and i != j and first.intersection(second).area > 0)
        if not mask[b, i] or not mask[b, j] or i == j:
            assert depth[b, i, j] == -np.inf
        elif abs(depth[b, i, j]) > 1e-4:
            assert overlap[b, i, j] == expected
            seen.add(expected)
            if not expected:
                assert first.distance(second) >= -depth[b, i, j] - 1e-4
    assert seen == {True, False}


def test_box_penetration_is_the_separating_shift():
    agents = np.zeros((2, 9), np.float32)
    agents[:, 4], agents[:, 6], agents[:, 7], agents[1, 0], agents[1, 1] = 1, 4, 2, 3, 0.5
    assert geometry.box_penetration(agents)[0, 1] == pytest.approx(1.0)
    agents[1, 0] = 4  # touching
    assert not geometry.boxes_overlap(agents).any()
    assert geometry.box_penetration(agents)[1, 0] == pytest.approx(0)


def test_geometry_gradients_are_finite_with_padding():
    batch, pose = example_batch(2), _poses(2)

    def loss(scene, pose, rotation):
        scene = geometry.move_se3(geometry.move(scene, pose), rotation, jnp.zeros((2, 3)))
        near = geometry.distance_to_polylines(scene.agents[..., :2], scene.lanes, scene.lane_mask)
        depth = geometry.box_penetration(scene.agents, scene.agent_mask)
        smooth = geometry.resample(scene.lanes.reshape(-1, 20, 3), 5)
        return jnp.where(jnp.isfinite(near), near, 0).sum() + jnp.maximum(depth, -9).sum() + jnp.square(smooth).sum()

    gradients = jax.jit(jax.grad(loss, (0, 1, 2), allow_int=True))(batch, pose, _rotations(2))
    for gradient in (gradients[0].agents, gradients[0].lanes, gradients[1], gradients[2]):
        assert np.isfinite(np.asarray(gradient)).all() and np.asarray(gradient).any()


def test_se2_apply_refuses_too_many_batch_axes():
    with pytest.raises(ValueError, match="a frame with batch axes"):
        geometry.se2_apply(_poses(2, 3), np.zeros((2, 2), np.float32))
