"""Steps of an optimizer on arrays beside steps of another on groups of them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax

from scjax.nn.functional import flatten


def assert_same_steps(params, param_groups, of_arrays, of_groups, **tolerances):
    """Four steps of one optimizer on arrays and of another on their groups end at the same parameters.

    Each optimizer's step is one program, as in trainings.
    """

    @jax.jit
    def step_of_arrays(number, arrays, state):
        updates, state = of_arrays.update(made_up_gradients(params, number), state, arrays)
        return optax.apply_updates(arrays, updates), state

    @jax.jit
    def step_of_groups(number, groups, state):
        gradients = param_groups.pack(made_up_gradients(params, number))
        updates, state = of_groups.update(gradients, state, groups)
        return optax.apply_updates(groups, updates), state

    arrays, groups = params, param_groups.pack(params)
    states = jax.jit(of_arrays.init)(arrays), jax.jit(of_groups.init)(groups)
    for step in range(4):
        arrays, first = step_of_arrays(step, arrays, states[0])
        groups, second = step_of_groups(step, groups, states[1])
        states = first, second
    for path, value in flatten(param_groups.unpack(groups)).items():
        np.testing.assert_allclose(value, flatten(arrays)[path], **tolerances)
        assert not np.allclose(value, flatten(params)[path])


def made_up_gradients(params, step):
    """Gradients that differ from step to step."""
    return jax.tree.map(lambda x: jnp.sin(3 * x + step), params)
