"""The one kind of record in scjax: a frozen, keyword-only dataclass that is a JAX PyTree."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import chex

T = TypeVar("T")
R = TypeVar("R", bound="Replaceable")


class Replaceable:
    """Base of the records that callers copy with changes."""

    def replace(self: R, **changes: Any) -> R:
        """A copy with these fields changed."""
        return dataclasses.replace(self, **changes)  # pyright: ignore[reportArgumentType]


@dataclass_transform(frozen_default=True, kw_only_default=True)
def pytree(cls: type[T]) -> type[T]:
    """``chex.dataclass``, frozen, in a form that type checkers understand. Its leaves are in name order."""
    decorated: Any = chex.dataclass(cls, frozen=True, mappable_dataclass=False)
    return decorated
