"""Energy of overlapping boxes, against the NumPy overlap test of the metrics."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.energies.overlap import overlap_depth, overlap_energy
from scjax.scene import stack
from scjax.scene.boxes import overlaps
from tests.factories.energy_scenes import boxes, scene_energy


@pytest.mark.parametrize(
    ("pose", "depth"),
    [
        ((3, 0, 0), 1.0),  # bumper to bumper
        ((0.5, 1.5, 0), 0.5),  # side by side
        ((2.5, 0, 90), 0.5),  # a T
        ((0, 0, 0), 2.0),  # one on the other: the width is the shortest move
        ((6, 0, 180), -2.0),
    ],
)
def test_depth_is_the_shortest_separating_move(pose, depth):
    agents = stack([boxes((0, 0, 0), pose)]).agents
    matrix = np.asarray(overlap_depth(agents))[0]
    np.testing.assert_allclose([matrix[0, 1], matrix[1, 0]], depth, atol=1e-5)


@pytest.fixture(scope="module")
def crowd():
    """(scene of 30 random boxes, their depths [30, 30] with -1 on the diagonal)."""
    rng = np.random.default_rng(0)
    scene = boxes(*np.concatenate([rng.uniform(-9, 9, (30, 2)), rng.uniform(-180, 180, (30, 1))], 1))
    depth = np.array(overlap_depth(stack([scene]).agents))[0]
    np.fill_diagonal(depth, -1)
    return scene, depth


def test_positive_depth_agrees_with_the_overlap_metric(crowd):
    scene, depth = crowd
    assert np.array_equal(depth > 1e-5, overlaps(np.asarray(scene.agents)))


def test_the_energy_is_half_the_squared_depth_over_pairs(crowd):
    scene, depth = crowd
    expected = 0.5 * sum(depth[i, j] ** 2 for i, j in np.argwhere(np.triu(depth > 0)))
    assert scene_energy(overlap_energy, scene, margin=0.0) == pytest.approx(expected, rel=1e-5)
    assert scene_energy(overlap_energy, scene) > expected, "the margin counts as overlap"


def test_gradient_descent_separates_boxes_without_turning_them():
    scene = stack([boxes((0, 0, 0), (3, 0.5, 10), (3.2, 1, 70))])
    gradient = jax.jit(jax.grad(lambda a: overlap_energy(scene.replace(agents=a)).sum()))
    agents = jnp.asarray(scene.agents)
    for _ in range(40):
        agents = agents - 0.4 * gradient(agents)
    assert not overlaps(np.asarray(agents[0])).any()
    np.testing.assert_array_equal(agents[..., 2:], scene.agents[..., 2:])
