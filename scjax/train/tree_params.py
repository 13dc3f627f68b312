"""Parameters as arrays, which devices hold in shares by rules over their paths (FSDP, ``scjax.nn.sharding.RULES``)."""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from scjax.nn.functional import Params, Path, flatten, unflatten
from scjax.nn.sharding import Sharding
from scjax.train.optimizer import KERNEL
from scjax.train.param_groups import Groups, Members, group_members


class TreeParams(NamedTuple):
    """The paths and shapes of each group; a group is a dict from dotted paths to arrays."""

    groups: Members

    @property
    def sharding(self) -> Sharding:
        """Arrays by rules over their paths."""
        return "fsdp"

    @classmethod
    def of(cls, params: Params, frozen: frozenset[Path] = frozenset()) -> TreeParams:
        """For parameters of these paths (also abstract ones); those at paths in ``frozen`` form a group."""
        return cls(group_members(params, frozen))

    def pack(self, params: Params) -> Groups:
        """The groups of parameters, or of their gradients."""
        leaves = flatten(params)
        return {name: {_dotted(path): leaves[path] for path, _ in members} for name, members in self.groups.items()}

    def unpack(self, groups: Groups) -> Params:
        """Inverse of ``pack``."""
        return unflatten(
            {path: groups[name][_dotted(path)] for name, members in self.groups.items() for path, _ in members}
        )

    @property
    def kernel_shapes(self) -> list[tuple[int, ...]]:
        """Shapes of the matrices of the kernel group."""
        return [shape for _, shape in self.groups.get(KERNEL, ())]

    def split_kernels(self, group: Groups) -> list[Any]:
        """The matrices of the kernel group."""
        return [group[_dotted(path)] for path, _ in self.groups[KERNEL]]

    def join_kernels(self, kernels: list[Float[Array, "_ _"]]) -> dict[str, Array]:
        """Inverse of ``split_kernels``."""
        return {_dotted(path): kernel for (path, _), kernel in zip(self.groups[KERNEL], kernels, strict=True)}


def _dotted(path: Path) -> str:
    return ".".join(map(str, path))
