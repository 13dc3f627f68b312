from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.energies.collision import collision_penalty, noise_weight
from scjax.diffusion.loss import diffusion_loss
from scjax.diffusion.schedule import cosine_schedule
from scjax.scene.per_type import PerType


def boxes(*places, heading=0.0, size=(4.5, 2.0)) -> jnp.ndarray:
    """One scene of equal boxes at x, y."""
    turn = np.deg2rad(heading)
    rows = [[x, y, 0.8, 5.0, np.cos(turn), np.sin(turn), *size, 1.5] for x, y in places]
    return jnp.array([rows], jnp.float32)


def penalty(agents, counted=None):
    return float(collision_penalty(agents, jnp.ones(agents.shape[:2], bool) if counted is None else counted)[0])


def test_boxes_apart_cost_nothing():
    assert penalty(boxes((0, 0), (4.6, 0), (0, 2.1))) == 0.0


def test_boxes_on_each_other_cost_most():
    assert penalty(boxes((0, 0), (0, 0))) == pytest.approx(np.tanh(5.0) / 2, abs=1e-3)
    assert penalty(boxes((0, 0), (3, 0))) < penalty(boxes((0, 0), (1, 0)))


def test_overlap_counts_along_the_heading():
    """3.5 m apart at 45 degrees: along the heading two cars overlap, across it they do not (spec §7, rotation sign)."""
    step = 3.5 / np.sqrt(2)
    assert penalty(boxes((0, 0), (step, step), heading=45)) > 0.1
    assert penalty(boxes((0, 0), (step, -step), heading=45)) == 0.0


@pytest.mark.parametrize("turn", [30.0, 90.0, 200.0])
def test_turning_the_world_changes_nothing(turn):
    places = np.array([[0, 0], [2.5, 0.7], [-3, -1]])
    angle = np.deg2rad(turn)
    moved = places @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    assert penalty(boxes(*moved, heading=turn)) == pytest.approx(penalty(boxes(*places)), abs=1e-5)


def test_gradient_pushes_centres_apart_and_nothing_else():
    both = jnp.ones((1, 2), bool)
    gradient = jax.grad(lambda agents: collision_penalty(agents, both).sum())(boxes((0, 0), (3.9, 0.2)))
    gradient = np.asarray(gradient)[0]
    assert gradient[1, 0] < 0 and np.abs(gradient[:, 2:]).max() == 0.0
    assert np.abs(gradient[0]).max() == 0.0  # the ego stays where it is


def test_padding_and_others_never_count():
    agents = jnp.concatenate([boxes((0, 0), (3, 0)), jnp.full((1, 2, 9), 1e3)], 1)
    assert penalty(agents, jnp.array([[True, True, False, False]])) == pytest.approx(penalty(boxes((0, 0), (3, 0))))
    assert penalty(boxes((0, 0), (3, 0)), jnp.array([[True, False]])) == 0.0


def test_a_scene_alone_equals_the_scene_in_a_batch():
    one, two = boxes((0, 0), (3, 0)), boxes((0, 0), (1, 1))
    both = collision_penalty(jnp.concatenate([one, two]), jnp.ones((2, 2), bool))
    np.testing.assert_allclose(both, [penalty(one), penalty(two)], rtol=1e-6)


def test_weight_is_large_where_the_scene_is_nearly_known():
    weight = np.asarray(noise_weight(cosine_schedule().levels))
    assert (np.diff(weight) < 0).all() and weight[0] > 0.97 and weight[-1] < 0.01


def test_the_penalty_sees_the_estimate_and_joins_the_loss():
    schedule = cosine_schedule()
    clean = PerType(agents=jnp.ones((2, 3, 4)), lanes=jnp.ones((2, 5, 6)))
    masks = jax.tree.map(lambda x: jnp.ones(x.shape[:2], bool), clean)
    known = masks.replace(agents=jnp.zeros((2, 3), bool).at[:, 0].set(True), lanes=jnp.zeros((2, 5), bool))
    noise = jax.tree.map(jnp.zeros_like, clean)
    level = schedule.levels[jnp.array([10, 60])]
    seen = []

    def record(latents, at):
        seen.append((latents, at))
        return jnp.array([1.0, 3.0])

    def perfect(z, _):
        return jax.tree.map(jnp.zeros_like, z)

    options = {"prediction": "noise", "penalty": record}
    loss, terms = diffusion_loss(perfect, level, clean, noise, masks, known, **options)
    for x, y in zip(jax.tree.leaves(seen[0][0]), jax.tree.leaves(clean), strict=True):
        np.testing.assert_allclose(x, y, atol=1e-5)
    np.testing.assert_array_equal(terms["penalty"], [1.0, 3.0])
    assert float(loss) == pytest.approx(2.0, abs=1e-6)
