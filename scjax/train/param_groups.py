"""How a training state holds parameters: as flat vectors (``FlatParams``) or as arrays (``TreeParams``), in groups.

A group is what the optimizer treats alike. Both choices have the same groups and the same methods.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Float

from scjax.nn.functional import Params, Path, flatten
from scjax.nn.sharding import Sharding
from scjax.train.optimizer import KERNEL, is_decayed

REST, FROZEN = "rest", "frozen"
"""Groups besides ``KERNEL``, on which weight decay acts: other parameters, and those that are not trained."""

Groups = dict[str, Any]
"""Group name -> its parameters, in the form of a ``ParamGroups``; empty groups are left out."""

Members = dict[str, tuple[tuple[Path, tuple[int, ...]], ...]]
"""Group name -> paths (``functional.flatten``) and shapes of its parameters."""


@runtime_checkable
class ParamGroups(Protocol):
    """Conversion between a parameter tree and the groups of a training state."""

    @property
    def groups(self) -> Members:
        """The parameters of each group."""
        ...

    @property
    def sharding(self) -> Sharding:
        """Which rules of ``scjax.nn.sharding.RULES`` place the groups on devices."""
        ...

    def pack(self, params: Params) -> Groups:
        """The groups of parameters, or of their gradients."""
        ...

    def unpack(self, groups: Groups) -> Params:
        """Inverse of ``pack``."""
        ...

    @property
    def kernel_shapes(self) -> list[tuple[int, ...]]:
        """Shapes of the matrices of the ``KERNEL`` group, in the order of ``split_kernels``."""
        ...

    def split_kernels(self, group: Any) -> list[Float[Array, "_ _"]]:
        """The matrices of the ``KERNEL`` group."""
        ...

    def join_kernels(self, kernels: list[Float[Array, "_ _"]]) -> Any:
        """Inverse of ``split_kernels``."""
        ...


def trained(groups: Groups) -> Groups:
    """All groups except the frozen one."""
    return {name: group for name, group in groups.items() if name != FROZEN}


def group_members(params: Params, frozen: frozenset[Path] = frozenset()) -> Members:
    """The groups of parameters (also of abstract ones); those at paths in ``frozen`` form a group; no empty groups."""
    groups: dict[str, list] = {KERNEL: [], REST: [], FROZEN: []}
    decays = flatten(is_decayed(params))
    for path, leaf in flatten(params).items():
        group = FROZEN if path in frozen else KERNEL if decays[path] else REST
        groups[group].append((path, np.shape(leaf)))
    return {name: tuple(members) for name, members in groups.items() if members}
