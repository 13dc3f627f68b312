"""The JAX twin agrees with the float64 projection, and its gradients are finite."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.camera import Camera, preset_rig, project_points, project_segments
from scjax.camera.jax_projection import camera_parameters, project_points_jax, project_segments_jax

POSITION = np.array([1.5, -0.25, 1.25])
PINHOLE, LENS = (preset_rig(name).camera() for name in ("nuplan-front-a", "nuplan-front-a-raw"))


def scattered(seed: int, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] around a camera, which float32 holds exactly, and its axes."""
    rng = np.random.default_rng(seed)
    axes = camera.rotation.astype(np.float32).astype(np.float64)
    offsets = np.column_stack([rng.normal(0, 20, 4000), rng.normal(0, 3, 4000), rng.uniform(-20, 80, 4000)])
    return (POSITION + offsets @ axes.T).astype(np.float32).astype(np.float64), axes


@pytest.mark.parametrize("camera", [PINHOLE, LENS], ids=["pinhole", "lens"])
def test_project_points_jax_agrees_with_numpy(camera):
    points, axes = scattered(0, camera)
    expected = project_points(camera, (points - POSITION) @ axes)
    actual = project_points_jax(camera_parameters(camera, axes, POSITION), points.astype(np.float32))
    inside = expected.visible & ((expected.pixels > 0) & (expected.pixels < [camera.width, camera.height])).all(-1)
    inside &= expected.depth > 1.0
    assert inside.sum() > 400
    assert (np.asarray(actual.visible) == expected.visible).mean() > 0.999
    assert np.abs(np.asarray(actual.pixels)[inside] - expected.pixels[inside]).max() < 1e-3


def test_project_segments_jax_agrees_with_numpy():
    points, axes = scattered(1, PINHOLE)
    first, second = points[::2], points[1::2]
    expected = project_segments(PINHOLE, (first - POSITION) @ axes, (second - POSITION) @ axes)
    parameters = camera_parameters(PINHOLE, axes, POSITION)
    actual = project_segments_jax(parameters, first.astype(np.float32), second.astype(np.float32))
    rows = np.flatnonzero(np.asarray(actual.visible))
    assert set(rows) ^ set(expected.rows) <= set(rows[:0])  # the same segments are visible
    near = expected.inverse_depths.max(1) < 1.0
    assert near.sum() > 200
    error = np.abs(np.asarray(actual.ends)[expected.rows] - expected.ends).max((1, 2))
    assert np.quantile(error[near], 0.95) < 1e-3 and error[near].max() < 0.05  # ends far beside lose digits


def test_project_points_jax_gradient_is_finite_behind_the_camera():
    parameters = camera_parameters(LENS, LENS.rotation, POSITION)

    def total(points):
        result = project_points_jax(parameters, points)
        return jnp.where(result.visible[..., None], result.pixels, 0.0).sum()

    points = jnp.array([[[-5.0, 0.0, 1.0], [1.5, -0.25, 1.25], [12.0, 1.0, 1.0], [1.51, 40.0, 1.0]]], jnp.float32)
    gradient = jax.grad(total)(points)
    assert jnp.isfinite(gradient).all() and (gradient[0, 2] != 0).any() and (gradient[0, 0] == 0).all()


def test_project_segments_jax_maps_over_cameras():
    parameters = [camera_parameters(dataclasses.replace(PINHOLE), PINHOLE.rotation, POSITION + k) for k in (0, 1)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *parameters)
    first, second = jnp.array([[5.0, 0.0, 0.0]]), jnp.array([[30.0, 0.0, 0.0]])
    result = jax.vmap(project_segments_jax, in_axes=(0, None, None))(stacked, first, second)
    assert result.ends.shape == (2, 1, 2, 2) and result.visible.all()
    assert (result.ends[0] != result.ends[1]).any()
