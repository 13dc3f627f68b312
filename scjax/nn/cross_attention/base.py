"""What all ways to condition scene tokens on context tokens have in common (attention-variants §2).

Two phases: ``encode`` computes once a scene what depends on the context alone, ``attend`` reads it in every denoising
step. The contract of every mechanism:

- rows of y are exactly zero where ``x_mask`` is False, and in scenes without any readable context token (except for
  ``concat``, whose scene tokens then read each other);
- what stands at masked tokens, NaN included, reaches neither results nor gradients;
- neither the residual nor the slot's AdaLN gate is applied here; statistics are stop-gradient.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from scjax.scene.pytree import pytree


@dataclasses.dataclass(frozen=True)
class ContextSpec:
    """How context tokens lie. Some parameters' shapes depend on it, so that it is told when a module is built.

    Attributes:
      kind: "text" and "generic" tokens follow each other; "image" tokens fill grids, row-major.
      grid: (rows, columns) of an image.
      modalities: how many such grids follow each other.
    """

    kind: Literal["text", "image", "generic"] = "generic"
    grid: tuple[int, int] | None = None
    modalities: int = 1

    def __post_init__(self):
        one_of(self, kind=("text", "image", "generic"))
        if (self.kind == "image") != (self.grid is not None):
            raise ValueError(f"ContextLayout.grid is (rows, columns) of an image, and None for text, not {self.grid}")
        if self.modalities < 1 or (self.grid is None and self.modalities > 1):
            raise ValueError(f"ContextLayout.modalities counts the grids of an image (1 for text): {self.modalities}")


@pytree
class AuxOutputs:
    """What ``attend`` tells besides its result.

    Attributes:
      loss: what the mechanism trains by a loss of its own, to be added to the objective: a mean over real scene
        tokens. None (statically, so that it costs nothing) where there is none.
      metrics: stop-gradient numbers: ``gate`` (tanh of a gate), ``selected`` (share of the readable keys that a query
        reads), ``overflow`` (share of the selected keys that a gather form had no room for), ``recall`` (share of the
        attention mass that the selected keys hold).
    """

    loss: Float[Array, ""] | None = None
    metrics: Mapping[str, Float[Array, ""]] = dataclasses.field(default_factory=dict)


@runtime_checkable
class CrossAttention(Protocol):
    """A conditioning mechanism, as ``scjax.nn.cross_attention.build`` makes it."""

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Any:
        """Context tokens -> a cache: a PyTree whose leaves all have the scenes as their first axis."""
        ...

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Any
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read, and what else is to be told of it."""
        ...


def readers(x_mask: Bool[Array, "b n"], mask: Bool[Array, "b m"]) -> Bool[Array, "b n"]:
    """Real scene tokens of scenes that have a readable context token."""
    return x_mask & mask.any(-1, keepdims=True)


def only(rows: Bool[Array, "b n"], y: Float[Array, "b n d"]) -> Float[Array, "b n d"]:
    """``y``, exactly zero elsewhere."""
    return jnp.where(rows[..., None], y, 0)


def mean_over(rows: Bool[Array, "b n"], values: Float[Array, "b n"]) -> Float[Array, ""]:
    """Mean of ``values`` over ``rows``; 0 without any."""
    return jnp.where(rows, values, 0).sum() / jnp.maximum(rows.sum(), 1)


def one_of(options: Any, **allowed: tuple[str, ...]) -> None:
    """Raises ValueError unless each named field of a dataclass has one of the values given for it."""
    for name, values in allowed.items():
        if getattr(options, name) not in values:
            told = ", ".join(map(repr, values))
            raise ValueError(f"{type(options).__name__}.{name} must be one of {told}, not {getattr(options, name)!r}")


def at_least(options: Any, **least: int) -> None:
    """Raises ValueError unless each named field of a dataclass is an integer of at least the value given for it."""
    for name, bound in least.items():
        value = getattr(options, name)
        if not isinstance(value, int) or isinstance(value, bool) or value < bound:
            raise ValueError(f"{type(options).__name__}.{name} must be an integer of at least {bound}, not {value!r}")
