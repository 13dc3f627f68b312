"""Initial parameters from one stream of random numbers.

A network has hundreds of arrays. Drawing each from a key of its own makes XLA compile hundreds of generators, which
takes longer than some trainings; so all numbers are drawn at once and handed out in the order of construction.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class ParamInit:
    """Hands out initial values while a module is built.

    Without ``numbers`` it gives zeros and only counts (``used``): a first, abstract construction tells how many
    uniform numbers in (-1, 1) the real one needs.
    """

    def __init__(self, numbers: Float[Array, " n"] | None = None):
        self._numbers = numbers
        self.used = 0

    def uniform(self, shape: tuple[int, ...], bound: float) -> Array:
        """U(-bound, bound)."""
        return self._next(shape) * bound

    def xavier(self, shape: tuple[int, int]) -> Array:
        """Xavier-uniform for a matrix [in, out] (Glorot & Bengio 2010)."""
        return self.uniform(shape, math.sqrt(6 / sum(shape)))

    def normal(self, shape: tuple[int, ...], std: float) -> Array:
        """N(0, std^2), by the inverse of the error function."""
        return jax.lax.erf_inv(self._next(shape)) * (math.sqrt(2) * std)

    def _next(self, shape: tuple[int, ...]) -> Array:
        start, self.used = self.used, self.used + math.prod(shape)
        if self._numbers is None:
            return jnp.zeros(shape)
        return self._numbers[start : self.used].reshape(shape)
