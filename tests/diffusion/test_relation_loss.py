"""What the parts of a scene owe each other: only what parts linked lanes, or an agent from its lane, costs."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.relation_loss import connection_error, estimate_weight, offset_error
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


def moved(scene: Scene, lanes=(0, 0), agents=(0, 0), lane=slice(None)) -> Scene:
    scene = scene.replace(lanes=scene.lanes.copy(), agents=scene.agents.copy())
    scene.lanes[lane, :, :2] += np.asarray(lanes, np.float32)
    scene.agents[:, :2] += np.asarray(agents, np.float32)
    return scene


def error(function, generated: Scene, scene: Scene) -> float:
    return float(function(stack([generated]), stack([scene]))[0])


def test_lanes_that_move_together_stay_joined():
    scene = road()
    assert error(connection_error, moved(scene, (3, -2)), scene) == pytest.approx(0, abs=1e-5)
    assert error(connection_error, moved(scene, (3, -4), lane=1), scene) == pytest.approx(5, abs=0.06)
    unlinked = scene.replace(links=np.diag([Link.SELF, Link.SELF]).astype(np.int32))
    assert error(connection_error, moved(scene, (3, -4), lane=1), unlinked) == 0


def test_an_open_joint_of_the_scene_is_no_error():
    scene = moved(road(), (0, 2), lane=1)
    assert error(connection_error, scene, scene) == pytest.approx(0, abs=1e-6)
    assert error(connection_error, road(), scene) == pytest.approx(2, abs=0.06)


def test_offsets_count_across_the_lane_only():
    scene = road()
    assert error(offset_error, moved(scene, agents=(5, 0)), scene) == pytest.approx(0, abs=1e-5)
    assert error(offset_error, moved(scene, agents=(5, 1.5)), scene) == pytest.approx(1.5, abs=0.06)
    assert error(offset_error, moved(scene, (0, 1.5), (5, 1.5)), scene) == pytest.approx(0, abs=1e-5)
    away = moved(scene, agents=(0, 10))  # nobody beside a lane
    assert error(offset_error, moved(away, agents=(0, 2)), away) == 0


@pytest.mark.parametrize("function", [connection_error, offset_error])
def test_padding_and_other_scenes_change_nothing_and_gradients_are_finite(function):
    scene, generated = road(), moved(moved(road(), agents=(1, 0.7)), (0.5, 1), lane=1)
    alone = error(function, generated, scene)
    nobody = empty(0, 0)
    generated, scene = (stack([pad(one, 5, 7), pad(nobody, 5, 7)]) for one in (generated, scene))
    np.testing.assert_allclose(function(generated, scene), [alone, 0], rtol=1e-6)

    def total(lanes, agents):
        return function(generated.replace(lanes=lanes, agents=agents), scene).sum()

    lanes, agents = jax.grad(total, (0, 1))(jnp.asarray(generated.lanes), jnp.asarray(generated.agents))
    assert np.isfinite(lanes).all() and np.isfinite(agents).all()
    assert not lanes[1].any() and not agents[1].any() and not lanes[0, 2:].any() and not agents[0, 2:].any()
    perfect = jax.grad(lambda lanes: function(scene.replace(lanes=lanes), scene).sum())(jnp.asarray(scene.lanes))
    assert np.isfinite(perfect).all()


def test_weight_follows_how_errors_shrink_and_ends_where_the_estimate_is_no_scene():
    levels = cosine_schedule().levels
    weight, noise = np.asarray(estimate_weight(levels)), np.asarray(levels.noise)
    middle = (noise > 0.1) & (noise < 0.5)
    np.testing.assert_allclose(weight[middle], 1 / noise[middle] - 2, rtol=1e-5)
    assert (weight[noise <= 0.1] > 7.9).all() and weight.max() < 10 and not weight[noise >= 0.5].any()
