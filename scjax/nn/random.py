"""Random draws for a batch, from one key for all rows or from one key per row.

With a key per row, the numbers of a row do not depend on the rest of the batch, nor on the device that computes it.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Integer


def fold_in(key: Array, data: int | Integer[Array, ""]) -> Array:
    """``jax.random.fold_in`` for one key, or for each of the keys [B]."""
    return jax.vmap(jax.random.fold_in, (0, None))(key, data) if key.ndim else jax.random.fold_in(key, data)


def row_keys(key: Array, indices: Integer[Array | np.ndarray, " b"]) -> Array:
    """A key per row [B] from one key and the number of each row."""
    return jax.vmap(jax.random.fold_in, (None, 0))(key, jnp.asarray(indices))


def normal(key: Array, shape: tuple[int, ...], dtype: jnp.dtype | type = jnp.float32) -> Float[Array, ...]:
    """N(0, 1) of this shape; with keys [B], row i of ``shape`` [B, ...] comes from key i."""
    return _draw(lambda k, s: jax.random.normal(k, s, dtype), key, shape)


def uniform(key: Array, shape: tuple[int, ...]) -> Float[Array, ...]:
    """U[0, 1) of this shape; keys as in ``normal``."""
    return _draw(jax.random.uniform, key, shape)


def randint(key: Array, shape: tuple[int, ...], least: int, end: int) -> Integer[Array, ...]:
    """Whole numbers from ``least`` up to but not including ``end``; keys as in ``normal``."""
    return _draw(lambda k, s: jax.random.randint(k, s, least, end), key, shape)


def bernoulli(key: Array, probability: float | Float[Array, ""], shape: tuple[int, ...]) -> Bool[Array, ...]:
    """True with this probability; keys as in ``normal``."""
    return _draw(lambda k, s: jax.random.bernoulli(k, probability, s), key, shape)


def _draw(draw: Callable[[Array, tuple[int, ...]], Array], key: Array, shape: tuple[int, ...]) -> Array:
    """
    Raises:
      ValueError: the number of keys differs from the number of rows.
    """
    if not key.ndim:
        return draw(key, shape)
    if key.shape != shape[:1]:
        raise ValueError(f"{key.shape} keys do not fit draws of shape {shape}: give one key, or one per row")
    return jax.vmap(lambda k: draw(k, shape[1:]))(key)
