"""Relation losses: only gaps between linked lanes and lateral offsets of agents from their lane cost."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.relation_loss import connection_error, lateral_offset_error, relation_weight
from scjax.diffusion.schedule import cosine_schedule
from scjax.scene import Link, Scene, empty, pad, stack


def road() -> Scene:
    """Two lanes of 20 m in a row to the east; a car 1 m to the left of the first, another 30 m off the road."""
    scene = empty(2, 2)
    for i in range(2):
        scene.lanes[i, :, 0] = np.linspace(20 * i, 20 * i + 20, 20)
    scene.links[:] = [[Link.SELF, Link.PREDECESSOR], [Link.SUCCESSOR, Link.SELF]]
    scene.agents[:] = (8, 1, 0, 0, 1, 0, 4, 2, 1.5)
    scene.agents[1, 1] = 30
    for mask in (scene.lane_mask, scene.lane_known, scene.agent_mask, scene.agent_known):
        mask[:] = True
    return scene


def shift(scene: Scene, lanes=(0, 0), agents=(0, 0), lane=slice(None)) -> Scene:
    """The scene with the lanes (or one lane) and the agents moved by (x, y) [m]."""
    scene = scene.replace(lanes=scene.lanes.copy(), agents=scene.agents.copy())
    scene.lanes[lane, :, :2] += np.asarray(lanes, np.float32)
    scene.agents[:, :2] += np.asarray(agents, np.float32)
    return scene


def error(function, generated: Scene, scene: Scene) -> float:
    return float(function(stack([generated]), stack([scene]))[0])


def test_lanes_that_move_together_stay_connected():
    scene = road()
    assert error(connection_error, shift(scene, (3, -2)), scene) == pytest.approx(0, abs=1e-5)
    assert error(connection_error, shift(scene, (3, -4), lane=1), scene) == pytest.approx(5, abs=0.06)
    unlinked = scene.replace(links=np.diag([Link.SELF, Link.SELF]).astype(np.int32))
    assert error(connection_error, shift(scene, (3, -4), lane=1), unlinked) == 0


def test_a_gap_in_the_recorded_scene_is_no_error():
    scene = shift(road(), (0, 2), lane=1)
    assert error(connection_error, scene, scene) == pytest.approx(0, abs=1e-6)
    assert error(connection_error, road(), scene) == pytest.approx(2, abs=0.06)


def test_offsets_count_across_the_lane_only():
    scene = road()
    assert error(lateral_offset_error, shift(scene, agents=(5, 0)), scene) == pytest.approx(0, abs=1e-5)
    assert error(lateral_offset_error, shift(scene, agents=(5, 1.5)), scene) == pytest.approx(1.5, abs=0.06)
    assert error(lateral_offset_error, shift(scene, (0, 1.5), (5, 1.5)), scene) == pytest.approx(0, abs=1e-5)
    off_road = shift(scene, agents=(0, 10))  # no agent is near a lane
    assert error(lateral_offset_error, shift(off_road, agents=(0, 2)), off_road) == 0


FUNCTIONS = [connection_error, lateral_offset_error]


def padded_batch() -> tuple[Scene, Scene]:
    """(generated, recorded) batches of the road and an empty scene, both padded."""
    scene, generated = road(), shift(shift(road(), agents=(1, 0.7)), (0.5, 1), lane=1)
    nothing = empty(0, 0)
    return tuple(stack([pad(one, 5, 7), pad(nothing, 5, 7)]) for one in (generated, scene))


@pytest.mark.parametrize("function", FUNCTIONS)
def test_padding_and_other_scenes_change_nothing(function):
    generated, scene = padded_batch()
    alone = error(function, shift(shift(road(), agents=(1, 0.7)), (0.5, 1), lane=1), road())
    np.testing.assert_allclose(function(generated, scene), [alone, 0], rtol=1e-6)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_gradients_are_finite_and_zero_at_padding(function):
    generated, scene = padded_batch()

    def total(lanes, agents):
        return function(generated.replace(lanes=lanes, agents=agents), scene).sum()

    lanes, agents = jax.jit(jax.grad(total, (0, 1)))(jnp.asarray(generated.lanes), jnp.asarray(generated.agents))
    assert np.isfinite(lanes).all() and np.isfinite(agents).all()
    assert not lanes[1].any() and not agents[1].any() and not lanes[0, 2:].any() and not agents[0, 2:].any()


@pytest.mark.parametrize("function", FUNCTIONS)
def test_gradients_are_finite_at_the_minimum(function):
    _, scene = padded_batch()
    gradient = jax.jit(jax.grad(lambda lanes: function(scene.replace(lanes=lanes), scene).sum()))
    assert np.isfinite(gradient(jnp.asarray(scene.lanes))).all()


def test_the_weight_is_the_inverse_noise_and_ends_at_a_half():
    levels = cosine_schedule().levels
    weight, sigma = np.asarray(relation_weight(levels)), np.asarray(levels.sigma)
    middle = (sigma > 0.1) & (sigma < 0.5)
    np.testing.assert_allclose(weight[middle], 1 / sigma[middle] - 2, rtol=1e-5)
    assert (weight[sigma <= 0.1] > 7.9).all() and weight.max() < 10 and not weight[sigma >= 0.5].any()
