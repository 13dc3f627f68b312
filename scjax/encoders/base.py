"""What a text encoder is to its users, and what a published network declares to become an encoder.

A new network is one file with a ``PublishedNetwork``, and one line in ``NETWORKS`` of ``scjax.encoders.text`` or, for
images, in ``IMAGE_NETWORKS`` of ``scjax.encoders.vision``.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, NamedTuple, Protocol, TypeAlias, runtime_checkable

import msgspec
import numpy as np
from flax import nnx
from jaxtyping import Float

from scjax.nn.functional import Functional, functional
from scjax.nn.state_dict import Rules

CONFIG_FILE, CONFIG_CURE = "config.json", "copy the encoder's folder again"

Size: TypeAlias = Annotated[int, msgspec.Meta(ge=1, le=2**20)]
"""Width, length or number of heads in a ``config.json``."""

Rows: TypeAlias = Annotated[int, msgspec.Meta(ge=1, le=2**24)]
"""Entries of a vocabulary."""

Layers: TypeAlias = Annotated[int, msgspec.Meta(ge=1, le=1024)]
Epsilon: TypeAlias = Annotated[float, msgspec.Meta(gt=0, le=1)]


class TokenFeatures(NamedTuple):
    """Features of one text's tokens; special tokens are among them, padding is not."""

    features: Float[np.ndarray, "tokens width"]
    texts: tuple[str, ...]


@runtime_checkable
class TextEncoder(Protocol):
    """Turns texts into token features. ``name`` differs between encoders whose features differ."""

    name: str

    @property
    def width(self) -> int:
        """Features of a token."""
        ...

    def __call__(self, texts: Sequence[str]) -> list[TokenFeatures]:
        """Token features of every text."""
        ...

    def is_cut(self, text: str) -> bool:
        """Whether ``text`` has more tokens than the encoder reads."""
        ...


@runtime_checkable
class TextNetworkConfig(Protocol):
    """Sizes of a network, read from the ``config.json`` of its release."""

    @property
    def width(self) -> int:
        """Features of a token."""
        ...

    @property
    def max_tokens(self) -> int:
        """Tokens that the network reads at most."""
        ...

    @property
    def vocab_size(self) -> int:
        """Number of different tokens."""
        ...


@dataclasses.dataclass(frozen=True)
class PublishedNetwork:
    """A published network: how its sizes and weights are read.

    Attributes:
      read_config: content of ``config.json`` -> config; ValueError for a variant that the module is not.
      module: (config, init=) -> the network.
      table_shapes: config -> key of the state dict and shape of the arrays that all sizes of the config decide.
      weight_rules: config -> keys of the transformers state dict and the parameters that they become.
      is_unused: key of the state dict -> whether no parameter needs it.
      rename: key of the state dict -> the key in ``weight_rules``, where releases name an array differently.
      aliases: (other key, key) of arrays that some releases store twice.
    """

    read_config: Callable[[Mapping[str, Any]], Any]
    module: Callable[..., nnx.Module]
    table_shapes: Callable[[Any], dict[str, tuple[int, ...]]]
    weight_rules: Callable[[Any], Rules]
    is_unused: Callable[[str], bool]
    rename: Callable[[str], str] = str
    aliases: tuple[tuple[str, str], ...] = ()


@functools.lru_cache(maxsize=8)
def pure_functions(network: PublishedNetwork, config: Any) -> Functional:
    """A network of these sizes as ``init`` and ``apply``."""
    return functional(lambda init: network.module(config, init=init))
