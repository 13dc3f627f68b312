"""Initial parameters: every array has random numbers of its own, named by its path in the network.

A generator per array would make XLA compile hundreds of them, which takes longer than some trainings. Here one
generator draws blocks of ``BLOCK`` numbers. The key of a block is a hash of the array's path and the block's number in
the array, so a layer that is added leaves the initial values of all others as they were.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

BLOCK = 512
"""Random numbers per key; an array takes a whole number of blocks."""

_LEAST = float(np.nextafter(np.float32(-1), np.float32(0)))  # > -1: the inverse error function stays finite


class ParamInit:
    """Gives a module its initial values while it is built.

    Without ``numbers`` it returns zeros and records each array that it returns (``requests``).

    Args:
      numbers: uniform numbers in (-1, 1) for every request, in the order of the requests.
    """

    def __init__(self, numbers: Iterable[Float[Array, " n"]] | None = None):
        self._numbers: Iterator[Array] | None = None if numbers is None else iter(numbers)
        self.requests: list[Array] = []

    def uniform(self, shape: tuple[int, ...], bound: float) -> Array:
        """U(-bound, bound)."""
        return self._record(self._next(shape) * bound)

    def xavier(self, shape: tuple[int, int]) -> Array:
        """Xavier-uniform for a matrix [in, out] (Glorot & Bengio 2010)."""
        return self.uniform(shape, math.sqrt(6 / sum(shape)))

    def normal(self, shape: tuple[int, ...], std: float) -> Array:
        """N(0, std^2), by the inverse of the error function."""
        return self._record(jax.lax.erf_inv(self._next(shape)) * (math.sqrt(2) * std))

    def _next(self, shape: tuple[int, ...]) -> Array:
        if self._numbers is None:
            return jnp.zeros(shape)
        return next(self._numbers).reshape(shape)

    def _record(self, value: Array) -> Array:
        if self._numbers is None:
            self.requests.append(value)
        return value


def path_numbers(key: jax.Array, paths: Sequence[str], sizes: Sequence[int]) -> list[Float[Array, " n"]]:
    """Uniform numbers in (-1, 1) for each path, as many as its size; each path's depend on ``key`` and itself alone."""
    if not sizes:
        return []
    blocks = [-(-size // BLOCK) for size in sizes]
    words = np.repeat(np.stack([_path_words(path) for path in paths]), blocks, axis=0)
    places = np.concatenate([np.arange(number, dtype=np.uint32) for number in blocks])

    def draw(words: UInt32[Array, 2], place: UInt32[Array, ""]) -> Float[Array, " block"]:
        block_key = jax.random.fold_in(jax.random.fold_in(jax.random.fold_in(key, words[0]), words[1]), place)
        return jax.random.uniform(block_key, (BLOCK,), minval=_LEAST)

    numbers = jax.vmap(draw)(jnp.asarray(words), jnp.asarray(places)).reshape(-1)
    starts = np.concatenate([[0], np.cumsum(blocks)[:-1]]) * BLOCK
    return [numbers[start : start + size] for start, size in zip(starts.tolist(), sizes, strict=True)]


def _path_words(path: str) -> np.ndarray:
    """64 bits of the path's SHA-256 as two uint32: the same on every machine."""
    return np.frombuffer(hashlib.sha256(path.encode()).digest()[:8], "<u4").astype(np.uint32)
