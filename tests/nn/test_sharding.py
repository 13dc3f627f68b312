"""Spreading scenes over devices changes where they are worked out, not what comes out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.sharding import scene_mesh, spread


def scenes(scale, keys, values, nothing):
    """Shared scale; per scene a draw from its own key and a sum of its own row."""
    init = jax.vmap(lambda key: jax.random.normal(key, (3,)))(keys)
    return {"init": init * scale, "sums": values.sum(1), "nothing": nothing}


@pytest.mark.parametrize("number", [1, 2, 3, 8])
def test_spread_scenes_are_the_same_scenes(number):
    arguments = (jnp.float32(2), jax.random.split(jax.random.key(0), number), np.arange(number * 4.0).reshape(-1, 4))
    alone = scenes(*arguments, None)
    shared = jax.jit(spread(scenes, shared=1))(*arguments, None)
    jax.tree.map(np.testing.assert_array_equal, alone, shared)


@pytest.mark.skipif(len(jax.devices()) < 2, reason="this machine shows JAX one device")
def test_work_is_really_spread():
    program = jax.jit(spread(lambda x: x * 2, shared=0))
    assert len(program(np.ones((4, 2))).sharding.device_set) == scene_mesh(4).size > 1


def test_devices_that_do_not_divide_the_scenes_are_left_out():
    three = (jax.devices() * 3)[:3]
    assert scene_mesh(4, three).size == 1
