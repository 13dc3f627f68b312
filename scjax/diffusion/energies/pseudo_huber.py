"""A robust penalty for energies of distances."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

LINEAR_BEYOND = 5.0
"""Distance [m] beyond which the penalty grows linearly. A larger connection gap is rather a false link."""


def pseudo_huber(square: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Pseudo-Huber (Charbonnier) penalty of squared distances [m^2]: half the square up to about 5 m, linear beyond."""
    return LINEAR_BEYOND**2 * (jnp.sqrt(1 + square / LINEAR_BEYOND**2) - 1)
