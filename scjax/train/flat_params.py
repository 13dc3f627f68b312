"""Parameters as one long vector per group, for optimizers, averages and sums over devices.

Hundreds of small arrays would each need programs of their own, which take long to compile and to start
(benchmarks/README.md has the measurement).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scjax.nn.functional import Params, Path, flatten, unflatten
from scjax.nn.sharding import Sharding
from scjax.train.optimizer import KERNEL
from scjax.train.param_groups import Groups, Members, group_members


class FlatParams(NamedTuple):
    """The paths (``functional.flatten``) and shapes of each group, in the order of its vector."""

    groups: Members

    @property
    def sharding(self) -> Sharding:
        """Vectors in equal shares."""
        return "flat"

    @classmethod
    def of(cls, params: Params, frozen: frozenset[Path] = frozenset()) -> FlatParams:
        """For parameters of these shapes (also abstract ones); those at paths in ``frozen`` form a group."""
        return cls(group_members(params, frozen))

    def pack(self, params: Params) -> dict[str, Float[Array, " numbers"]]:
        """The vectors of parameters, or of their gradients; without groups of which ``params`` has nothing."""
        leaves = flatten(params)
        return {
            name: jnp.concatenate([leaves[path].reshape(-1) for path, _ in members])
            for name, members in self.groups.items()
            if any(path in leaves for path, _ in members)
        }

    def unpack(self, groups: Groups) -> Params:
        """Inverse of ``pack``."""
        leaves = {}
        for name, members in self.groups.items():
            end = 0
            for path, shape in members:
                start, end = end, end + math.prod(shape)
                leaves[path] = groups[name][start:end].reshape(shape)
        return unflatten(leaves)

    @property
    def kernel_shapes(self) -> list[tuple[int, ...]]:
        """Shapes of the matrices in the kernel vector."""
        return [shape for _, shape in self.groups.get(KERNEL, ())]

    def split_kernels(self, group: Float[Array, " numbers"]) -> list[Float[Array, "_ _"]]:
        """The matrices of the kernel vector."""
        ends = np.cumsum([math.prod(shape) for shape in self.kernel_shapes])
        parts = jnp.split(group, ends[:-1])
        return [part.reshape(shape) for shape, part in zip(self.kernel_shapes, parts, strict=True)]

    def join_kernels(self, kernels: list[Float[Array, "_ _"]]) -> Float[Array, " numbers"]:
        """Inverse of ``split_kernels``."""
        return jnp.concatenate([kernel.reshape(-1) for kernel in kernels])
