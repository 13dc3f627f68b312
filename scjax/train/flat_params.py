"""Parameters as a few long vectors, for whatever treats every number alike: optimisers, averages, sums over devices.

Of hundreds of small arrays each would be some programs of its own to compile and to start (benchmarks/README.md has
what that took).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scjax.nn.functional import Params, Path, flatten, unflatten
from scjax.train.optimizer import KERNEL, decayed

REST, KEPT = "rest", "kept"
"""Groups beside ``KERNEL``, on which weight decay acts: other parameters, and those that are not trained."""

Vectors = dict[str, Any]
"""Group -> vector of all its numbers; groups without any are left out."""


class FlatParams(NamedTuple):
    """Which parameters lie where: of each group, paths (``functional.flatten``) and shapes in their order."""

    groups: dict[str, tuple[tuple[Path, tuple[int, ...]], ...]]

    @classmethod
    def of(cls, params: Params, kept: frozenset[Path] = frozenset()) -> FlatParams:
        """For parameters of these shapes (also abstract ones); those at paths in ``kept`` have a group of their own."""
        groups: dict[str, list] = {KERNEL: [], REST: [], KEPT: []}
        decays = flatten(decayed(params))
        for path, leaf in flatten(params).items():
            group = KEPT if path in kept else KERNEL if decays[path] else REST
            groups[group].append((path, np.shape(leaf)))
        return cls({name: tuple(members) for name, members in groups.items() if members})

    def pack(self, params: Params) -> dict[str, Float[Array, " numbers"]]:
        """The vectors of parameters, or of gradients by them."""
        leaves = flatten(params)
        return {
            name: jnp.concatenate([leaves[path].reshape(-1) for path, _ in members])
            for name, members in self.groups.items()
        }

    def unpack(self, vectors: Vectors) -> Params:
        """Inverse of ``pack``."""
        leaves = {}
        for name, members in self.groups.items():
            end = 0
            for path, shape in members:
                start, end = end, end + math.prod(shape)
                leaves[path] = vectors[name][start:end].reshape(shape)
        return unflatten(leaves)


def trained(vectors: Vectors) -> Vectors:
    """All groups but those that are kept."""
    return {name: vector for name, vector in vectors.items() if name != KEPT}
