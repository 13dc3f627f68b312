"""The paper's collision penalty, as an energy and in the training loss."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.energies.collision import collision_energy, collision_weight
from scjax.diffusion.loss import diffusion_loss
from scjax.diffusion.schedule import cosine_schedule
from scjax.scene import AgentType, Scene, pad, stack
from scjax.scene.per_type import PerType
from tests.factories.energy_scenes import boxes, scene_energy


def cars(*places, heading=0.0) -> Scene:
    """Vehicles of 4.5 x 2 m with one heading [degrees] at (x, y)."""
    return boxes(*((x, y, heading) for x, y in places), size=(4.5, 2.0), speed=5.0)


def energy(scene: Scene) -> float:
    return scene_energy(collision_energy, scene)


def test_separate_boxes_have_no_energy():
    assert energy(cars((0, 0), (4.6, 0), (0, 2.1))) == 0.0


def test_the_energy_grows_with_the_overlap():
    assert energy(cars((0, 0), (0, 0))) == pytest.approx(np.tanh(5.0) / 2, abs=1e-3)
    assert energy(cars((0, 0), (3, 0))) < energy(cars((0, 0), (1, 0)))


def test_overlap_is_measured_along_the_heading():
    """3.5 m apart at 45 degrees: two cars overlap along their heading but not across it (spec §7, rotation sign)."""
    step = 3.5 / np.sqrt(2)
    assert energy(cars((0, 0), (step, step), heading=45)) > 0.1
    assert energy(cars((0, 0), (step, -step), heading=45)) == 0.0


@pytest.mark.parametrize("turn", [30.0, 90.0, 200.0])
def test_the_energy_is_invariant_to_rotation(turn):
    places = np.array([[0, 0], [2.5, 0.7], [-3, -1]])
    angle = np.deg2rad(turn)
    rotated = places @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    assert energy(cars(*rotated, heading=turn)) == pytest.approx(energy(cars(*places)), abs=1e-5)


def test_only_centers_receive_gradients_except_the_ego():
    scene = stack([cars((0, 0), (3.9, 0.2))])
    gradient = jax.jit(jax.grad(lambda agents: collision_energy(scene.replace(agents=agents)).sum()))
    gradient = np.asarray(gradient(jnp.asarray(scene.agents)))[0]
    assert gradient[1, 0] < 0 and np.abs(gradient[:, 2:]).max() == 0.0
    assert np.abs(gradient[0]).max() == 0.0  # the ego


def test_padding_never_counts():
    scene = cars((0, 0), (3, 0))
    padded = pad(scene, 4, 0)
    padded.agents[2:] = 1e3
    assert energy(padded) == pytest.approx(energy(scene))


def test_other_agent_types_never_count():
    scene = cars((0, 0), (3, 0))
    scene.agent_types[1] = AgentType.PEDESTRIAN
    assert energy(scene) == 0.0


def test_a_scene_alone_equals_the_scene_in_a_batch():
    first, second = cars((0, 0), (3, 0)), cars((0, 0), (1, 1))
    together = jax.jit(collision_energy)(stack([first, second]))
    np.testing.assert_allclose(together, [energy(first), energy(second)], rtol=1e-6)


def test_the_weight_falls_with_the_noise():
    weight = np.asarray(collision_weight(cosine_schedule().levels))
    assert (np.diff(weight) < 0).all() and weight[0] > 0.97 and weight[-1] < 0.01


@pytest.fixture(scope="module")
def penalized_loss():
    """(loss, terms, x0 estimate of the penalty, clean latents) with an exact network and a constant penalty."""
    clean = PerType(agents=jnp.ones((2, 3, 4)), lanes=jnp.ones((2, 5, 6)))
    masks = jax.tree.map(lambda x: jnp.ones(x.shape[:2], bool), clean)
    known = masks.replace(agents=jnp.zeros((2, 3), bool).at[:, 0].set(True), lanes=jnp.zeros((2, 5), bool))
    noise = jax.tree.map(jnp.zeros_like, clean)
    level = cosine_schedule().levels[jnp.array([10, 60])]
    estimates = []

    def penalty(latents, level):
        estimates.append(latents)
        return jnp.array([1.0, 3.0])

    def zero_noise(z, t):
        return jax.tree.map(jnp.zeros_like, z)

    loss, terms = diffusion_loss(zero_noise, level, clean, noise, masks, known, prediction="noise", penalty=penalty)
    return loss, terms, estimates[0], clean


def test_the_penalty_receives_the_x0_estimate(penalized_loss):
    _, _, estimate, clean = penalized_loss
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-5), estimate, clean)


def test_the_penalty_is_added_to_the_loss(penalized_loss):
    loss, terms, _, _ = penalized_loss
    np.testing.assert_array_equal(terms["penalty"], [1.0, 3.0])
    assert float(loss) == pytest.approx(2.0, abs=1e-6)
