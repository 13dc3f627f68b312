"""Arrays as 8-bit integers with a factor for each last index: a quarter of the bytes of float32."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

_FACTOR = ":factor"
_LEAST_SIZE = 1024  # of an array that is rounded
_LARGEST = 127


def round_arrays(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Large matrices as int8, each beside its factors; other arrays as they are."""
    rounded: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if array.ndim < 2 or array.size < _LEAST_SIZE:
            rounded[name] = array
            continue
        largest = np.abs(array).max(tuple(range(array.ndim - 1)))
        factor = np.where(largest > 0, largest / _LARGEST, 1.0).astype(np.float16).astype(np.float32)
        factor = np.where(factor > 0, factor, 1.0)
        rounded[name] = np.clip(np.rint(array / factor), -_LARGEST, _LARGEST).astype(np.int8)
        rounded[name + _FACTOR] = factor
    return rounded


def restore_arrays(rounded: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The inverse of ``round_arrays``, up to its rounding."""
    factors = {name: array for name, array in rounded.items() if name.endswith(_FACTOR)}
    return {
        name: array.astype(np.float32) * factors[name + _FACTOR] if name + _FACTOR in factors else array
        for name, array in rounded.items()
        if name not in factors
    }
