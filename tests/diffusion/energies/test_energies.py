"""The weighted sum of energies, and properties that all energies share."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.defaults import DEFAULT_ENERGIES
from scjax.diffusion.energies import ENERGIES, weighted_energy
from scjax.scene import pad, stack
from tests.factories.energy_scenes import boxes, scene_energy, two_lanes


def faulty_scene():
    """Two overlapping vehicles that are too far from a lane, and an open connection."""
    lanes = pad(two_lanes((1, 0)), 2, 2)
    scene = boxes((0, 3, 0), (3, 3, 0), speed=9.0)
    return scene.replace(lanes=lanes.lanes, links=lanes.links, lane_mask=lanes.lane_mask)


def test_default_energies_are_weighted_1_1_and_a_half():
    scene = faulty_scene()
    connections, overlap, off_lane = (scene_energy(ENERGIES[n], scene) for n in ("connections", "overlap", "off_lane"))
    assert min(connections, overlap, off_lane) > 0
    total = scene_energy(weighted_energy, scene, energies=DEFAULT_ENERGIES)
    assert total == pytest.approx(connections + overlap + 0.5 * off_lane, rel=1e-6)


@pytest.mark.parametrize("name", ENERGIES)
def test_padding_changes_no_energy(name):
    scene = faulty_scene()
    assert scene_energy(ENERGIES[name], scene) > 0
    padded = scene_energy(ENERGIES[name], pad(scene, 5, 6))
    assert padded == pytest.approx(scene_energy(ENERGIES[name], scene), rel=1e-6)


@pytest.mark.parametrize("scene", [faulty_scene(), two_lanes((1, 0)), boxes((0, 0, 0), (3, 0, 0))])
@pytest.mark.parametrize("name", ENERGIES)
def test_gradients_are_finite_with_padding(name, scene):
    batch = stack([pad(scene, 5, 6)])

    def total(agents, lanes):
        return ENERGIES[name](batch.replace(agents=agents, lanes=lanes)).sum()

    gradients = jax.jit(jax.grad(total, (0, 1)))(jnp.asarray(batch.agents), jnp.asarray(batch.lanes))
    assert all(np.isfinite(gradient).all() for gradient in gradients)
