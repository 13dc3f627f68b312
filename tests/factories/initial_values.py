"""Initial parameters without a compiler: the program that draws those of a network takes a second to compile."""

from __future__ import annotations

from collections.abc import Callable

import jax
import numpy as np
from flax import nnx

from scjax.nn.functional import Params
from scjax.nn.init import ParamInit


class NumPyInit(ParamInit):
    """``ParamInit`` with numbers of NumPy. (``jnp.asarray`` would compile for every shape.)"""

    def __init__(self, seed: int = 0):
        super().__init__()
        self._rng = np.random.default_rng(seed)

    def uniform(self, shape: tuple[int, ...], bound: float) -> jax.Array:
        return jax.device_put(self._rng.uniform(-bound, bound, shape).astype(np.float32))

    def normal(self, shape: tuple[int, ...], std: float) -> jax.Array:
        return jax.device_put(self._rng.normal(0, std, shape).astype(np.float32))


def initial_params(make: Callable[[ParamInit], nnx.Module], *, noise: float = 0.0, seed: int = 0) -> Params:
    """Parameters of the module that ``make`` builds, on the host, moved by N(0, noise^2) so that no branch is idle."""
    params = jax.device_get(nnx.to_pure_dict(nnx.state(make(NumPyInit(seed)))))
    rng = np.random.default_rng(seed + 1)
    return jax.tree.map(lambda leaf: leaf + noise * rng.normal(size=leaf.shape).astype(leaf.dtype), params)
