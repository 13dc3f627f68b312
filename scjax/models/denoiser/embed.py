"""Position and time codes: fixed functions of an index, never parameters (official-spec §3, §4.1, §4.8)."""

from __future__ import annotations

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Real

TIME_CODE = 256


@functools.cache
def position_table(first: int, rows: int, width: int) -> Float[np.ndarray, "rows width"]:
    """Row r codes position first + r as [sin(p w_k) ; cos(p w_k)], w_k = 10000^(-k / (width / 2)); float64."""
    return _codes(np.arange(first, first + rows, dtype=np.float64), width)


@functools.cache
def image_table(rows: int, columns: int, width: int) -> Float[np.ndarray, "cells width"]:
    """Row-major cells; the first half of the width codes the column, the second half the row; float64."""
    row, column = np.divmod(np.arange(rows * columns, dtype=np.float64), columns)
    return np.concatenate([_codes(column, width // 2), _codes(row, width // 2)], 1)


def time_code(t: Real[Array, " b"], dtype) -> Float[Array, "b code"]:
    """[cos(t w_i) ; sin(t w_i)], w_i = 10000^(-i / 128): 256 numbers a timestep."""
    frequencies = jnp.asarray(_frequencies(TIME_CODE // 2), dtype)
    angles = t[:, None].astype(dtype) * frequencies[None]
    return jnp.concatenate([jnp.cos(angles), jnp.sin(angles)], -1)


def _frequencies(count: int) -> np.ndarray:
    return 10000.0 ** (-np.arange(count, dtype=np.float64) / count)


def _codes(positions: np.ndarray, width: int) -> np.ndarray:
    angles = positions[:, None] * _frequencies(width // 2)[None]
    return np.concatenate([np.sin(angles), np.cos(angles)], 1)
