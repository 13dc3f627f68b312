"""The interface of the cross-attention mechanisms, which condition scene tokens on context tokens.

Two phases: ``encode`` computes what depends on the context alone, once per scene; ``attend`` reads it in every
denoising step. Every mechanism guarantees (attention-variants §2):

- rows of y are exactly zero where ``x_mask`` is False, and in scenes without any readable context token (except for
  ``concat``, whose scene tokens then read each other);
- values at masked tokens, NaN included, reach neither results nor gradients;
- neither the residual nor the stage's AdaLN gate is applied here; metrics have no gradient.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from scjax.nn.cpu.precision import Compute
from scjax.nn.init import ParamInit
from scjax.scene.pytree import pytree


@dataclasses.dataclass(frozen=True)
class ContextSpec:
    """How context tokens lie. Shapes of some parameters depend on it, so a module is built for one layout.

    Attributes:
      kind: "text" and "generic" tokens follow each other; "image" tokens fill grids, row-major.
      grid: (rows, columns) of an image; None for text.
      modalities: number of such grids, one after the other.
    """

    kind: Literal["text", "image", "generic"] = "generic"
    grid: tuple[int, int] | None = None
    modalities: int = 1

    def __post_init__(self):
        one_of(self, kind=("text", "image", "generic"))
        if (self.kind == "image") != (self.grid is not None):
            raise ValueError(f"ContextSpec.grid is (rows, columns) of an image, and None for text, not {self.grid}")
        if self.modalities < 1 or (self.grid is None and self.modalities > 1):
            raise ValueError(f"ContextSpec.modalities counts the grids of an image (1 for text): {self.modalities}")


class Work(NamedTuple):
    """Multiply-adds of one module and scene (attention-variants §4).

    What a sparse mechanism leaves out is not counted, whichever form computes it.

    Attributes:
      encode: what depends on the context alone.
      attend: what every denoising step repeats.
    """

    encode: float
    attend: float


@dataclasses.dataclass(frozen=True)
class CrossAttentionOptions(abc.ABC):
    """Base of the options of a mechanism: frozen, hashable dataclasses, part of a network's config.

    Attributes:
      name: the mechanism's name in configs.
      empty_is_zero: whether a scene without readable context tokens gets exactly zero.
    """

    name: ClassVar[str]
    empty_is_zero: ClassVar[bool] = True

    @abc.abstractmethod
    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> CrossAttention | None:
        """The module; None for no mechanism.

        Args:
          width, heads: of the scene tokens and of the context tokens.
          spec: how the context tokens lie.

        Raises:
          ValueError: the options do not fit the layout.
        """

    @abc.abstractmethod
    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds for ``queries`` scene tokens and ``context`` context tokens."""


@pytree
class AuxOutputs:
    """Outputs of ``attend`` besides its result.

    Attributes:
      loss: a loss of the mechanism's own, added to the objective: a mean over real scene tokens. None (statically, so
        that it costs nothing) where there is none.
      metrics: numbers without gradient: ``gate`` (tanh of a gate), ``selected`` (share of the readable keys that a
        query reads), ``recall`` (share of the attention mass on the selected keys).
    """

    loss: Float[Array, ""] | None = None
    metrics: Mapping[str, Float[Array, ""]] = dataclasses.field(default_factory=dict)


@runtime_checkable
class CrossAttention(Protocol):
    """A mechanism's module, as ``CrossAttentionOptions.build`` returns it."""

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Any:
        """Context tokens -> a cache: a PyTree whose leaves all have the scenes as their first axis."""
        ...

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Any
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read from the cache."""
        ...


def active_rows(x_mask: Bool[Array, "b n"], mask: Bool[Array, "b m"]) -> Bool[Array, "b n"]:
    """Real scene tokens of scenes that have a readable context token."""
    return x_mask & mask.any(-1, keepdims=True)


def mask_rows(rows: Bool[Array, "b n"], y: Float[Array, "b n d"]) -> Float[Array, "b n d"]:
    """``y`` where ``rows`` is True, exactly zero elsewhere."""
    return jnp.where(rows[..., None], y, 0)


def mean_over(rows: Bool[Array, "b n"], values: Float[Array, "b n"]) -> Float[Array, ""]:
    """Mean of ``values`` over ``rows``; 0 if there are none."""
    return jnp.where(rows, values, 0).sum() / jnp.maximum(rows.sum(), 1)


def one_of(options: Any, **allowed: tuple[str, ...]) -> None:
    """Raises ValueError unless each named field of a dataclass has one of its allowed values."""
    for name, values in allowed.items():
        if getattr(options, name) not in values:
            choices = ", ".join(map(repr, values))
            raise ValueError(
                f"{type(options).__name__}.{name} must be one of {choices}, not {getattr(options, name)!r}"
            )


def at_least(options: Any, **bounds: int) -> None:
    """Raises ValueError unless each named field of a dataclass is an integer of at least its bound."""
    for name, bound in bounds.items():
        value = getattr(options, name)
        if not isinstance(value, int) or isinstance(value, bool) or value < bound:
            raise ValueError(f"{type(options).__name__}.{name} must be an integer of at least {bound}, not {value!r}")
