"""Steps of an optimizer on arrays beside steps of another on groups of them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax

from scjax.nn.functional import flatten


def assert_same_steps(params, param_groups, of_arrays, of_groups, **tolerances):
    """Four steps of one optimizer on arrays and of another on their groups end at the same parameters."""
    arrays, groups = params, param_groups.pack(params)
    states = of_arrays.init(arrays), of_groups.init(groups)
    for step in range(4):
        gradients = made_up_gradients(params, step)
        updates, first = of_arrays.update(gradients, states[0], arrays)
        packed, second = of_groups.update(param_groups.pack(gradients), states[1], groups)
        arrays, groups = optax.apply_updates(arrays, updates), optax.apply_updates(groups, packed)
        states = first, second
    for path, value in flatten(param_groups.unpack(groups)).items():
        np.testing.assert_allclose(value, flatten(arrays)[path], **tolerances)
        assert not np.allclose(value, flatten(params)[path])


def made_up_gradients(params, step):
    """Gradients that differ from step to step."""
    return jax.tree.map(lambda x: jnp.sin(3 * x + step), params)
