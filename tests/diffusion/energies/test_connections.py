"""Energy of open lane connections."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.energies.connections import connection_energy
from scjax.scene import Link, stack
from tests.factories.energy_scenes import scene_energy, two_lanes


def test_the_energy_is_half_the_squared_gap():
    assert scene_energy(connection_energy, two_lanes()) == 0
    assert scene_energy(connection_energy, two_lanes((0.3, -0.4))) == pytest.approx(0.125, rel=0.01)


def test_the_energy_of_wide_gaps_is_linear():
    assert scene_energy(connection_energy, two_lanes((30, 40))) == pytest.approx(5 * 50, rel=0.12)


def test_lanes_without_a_link_have_no_energy():
    unlinked = two_lanes((3, 4)).replace(links=np.diag([Link.SELF, Link.SELF]).astype(np.int32))
    assert scene_energy(connection_energy, unlinked) == 0


def test_gradient_descent_closes_the_gap():
    scene = stack([two_lanes((3, 4))])
    gradient = jax.jit(jax.grad(lambda x: connection_energy(scene.replace(lanes=x)).sum()))
    lanes = jnp.asarray(scene.lanes)
    for _ in range(40):
        lanes = lanes - 0.4 * gradient(lanes)
    assert float(jnp.abs(lanes[0, 0, -1] - lanes[0, 1, 0]).max()) < 1e-3
