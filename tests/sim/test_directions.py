"""Unit vectors of headings."""

import jax
import jax.numpy as jnp
import numpy as np

from scjax.sim.directions import directions


def test_directions_are_cosines_and_sines():
    heading = jnp.linspace(-9.0, 9.0, 64)
    cos, sin = jax.jit(directions)(heading)
    np.testing.assert_array_equal(cos, jax.jit(jnp.cos)(heading))
    np.testing.assert_array_equal(sin, jax.jit(jnp.sin)(heading))
