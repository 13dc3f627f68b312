"""The one kind of record in scjax: a frozen, keyword-only dataclass that is a JAX PyTree."""

from __future__ import annotations

from typing import Any, TypeVar, dataclass_transform

import chex

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def pytree(cls: type[T]) -> type[T]:
    """``chex.dataclass``, frozen, in a form that type checkers understand. Adds ``replace(**changes)``."""
    made: Any = chex.dataclass(cls, frozen=True, mappable_dataclass=False)
    return made
