"""Energy of vehicles that are too far from every lane."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.energies.off_lane import off_lane_energy
from scjax.scene import AgentType, pad, stack
from tests.factories.energy_scenes import boxes, scene_energy, two_lanes


def energy_at(y: float, speed: float, agent_type=AgentType.VEHICLE) -> float:
    """Energy of one agent at lateral offset y [m] from a lane."""
    scene = pad(two_lanes(), 2, 2)
    scene = scene.replace(
        agents=np.zeros_like(scene.agents),
        agent_types=np.full_like(scene.agent_types, agent_type),
        agent_mask=np.array([True, False]),
    )
    scene.agents[:, :4] = (7, y, 0, speed)
    return scene_energy(off_lane_energy, scene)


def test_moving_vehicles_may_be_1_m_and_stationary_ones_4_m_away():
    assert energy_at(0.9, 5.0) == energy_at(-3.9, 0.0) == 0
    assert energy_at(1.5, 5.0) == pytest.approx(0.125, rel=0.01)
    assert energy_at(-4.5, 0.0) == pytest.approx(0.125, rel=0.01)


def test_the_energy_of_large_distances_is_linear():
    assert energy_at(51.0, 5.0) == pytest.approx(5 * 50, rel=0.12)


def test_pedestrians_have_no_energy():
    assert energy_at(3.0, 5.0, AgentType.PEDESTRIAN) == 0


def test_scenes_without_lanes_have_no_energy():
    assert scene_energy(off_lane_energy, boxes((0, 9, 0))) == 0


@pytest.fixture(scope="module")
def far_vehicle():
    """A moving vehicle 3 m from its lane, in a batch of one."""
    scene = stack([pad(two_lanes(), 1, 2).replace(agent_mask=np.array([True]))])
    agents = np.zeros_like(scene.agents)
    agents[0, 0, :4] = (7, -3, 0, 5)
    return scene.replace(agents=agents)


def test_gradient_descent_moves_a_vehicle_to_its_lane(far_vehicle):
    gradient = jax.jit(jax.grad(lambda a: off_lane_energy(far_vehicle.replace(agents=a)).sum()))
    agents = jnp.asarray(far_vehicle.agents)
    for _ in range(20):
        agents = agents - 0.4 * gradient(agents)
    np.testing.assert_allclose(agents[0, 0, :2], (7, -1), atol=1e-2)


def test_lanes_receive_no_gradient(far_vehicle):
    gradient = jax.grad(lambda x: off_lane_energy(far_vehicle.replace(lanes=x)).sum())
    assert not gradient(jnp.asarray(far_vehicle.lanes)).any()
