"""The network that reads a prompt: token features in, one answer for each attribute out.

A transformer over the tokens, whose blocks begin with a convolution over neighbors, then one learned query for each
attribute. The features come from a frozen encoder; the value of a number in the text is an input of its own, so that
numbers of all languages are the same to the network.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float, Int

from scjax.nn.attention import attend
from scjax.nn.functional import Functional, functional
from scjax.nn.init import ParamInit
from scjax.nn.layers import LayerNorm, Linear

_STD = 0.02
_NUMBER_STD = 0.5
_LONGEST_WAVE = 10_000.0  # tokens
_PLACE_SCALE = 0.3


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReaderConfig:
    """Sizes of the network.

    Attributes:
      text_width: features of a token.
      named: attributes whose values have names; values: names that each of them has at most, "unspecified" included.
      ranges: attributes that are ranges.
      levels: numbers that an end of a range can be.
      numbers: values that the number of a token can have; 0 is a token without one.
      width, blocks, heads: of the transformer.
      kernel: tokens that the convolution reads at once, an odd number.
    """

    text_width: int
    named: int
    values: int
    ranges: int
    levels: int
    numbers: int
    width: int = 192
    blocks: int = 1
    heads: int = 4
    kernel: int = 5

    def __post_init__(self):
        for field in dataclasses.fields(self):
            if getattr(self, field.name) < 1:
                raise ValueError(f"ReaderConfig.{field.name} must be at least 1, not {getattr(self, field.name)}")
        if self.width % (2 * self.heads):
            raise ValueError(f"ReaderConfig.width {self.width} must be a multiple of two times heads {self.heads}")
        if self.kernel % 2 == 0:
            raise ValueError(f"ReaderConfig.kernel must be odd, not {self.kernel}")


class ReaderOutputs(NamedTuple):
    """Logits.

    Attributes:
      named: of every value of every attribute with named values.
      ends: of every number that the lower and the upper end of every range can be.
    """

    named: Float[Array, "b named values"]
    ends: Float[Array, "b ranges 2 levels"]


class _Block(nnx.Module):
    """x + convolution(LN(x)), x + attention(LN(x)), then x + MLP(LN(x))."""

    def __init__(self, config: ReaderConfig, *, init: ParamInit):
        width = config.width
        self.near_norm, self.near_out = LayerNorm(width), Linear(width, width, init=init)
        self.near = nnx.Param(init.normal((config.kernel, width), config.kernel**-0.5))
        self.norm, self.mlp_norm = LayerNorm(width), LayerNorm(width)
        self.query, self.key = Linear(width, width, init=init), Linear(width, width, init=init)
        self.value, self.out = Linear(width, width, init=init), Linear(width, width, init=init)
        self.up, self.down = Linear(width, 4 * width, init=init), Linear(4 * width, width, init=init)
        self.heads = config.heads

    def __call__(self, x: Float[Array, "b n d"], mask: Bool[Array, "b n"]) -> Float[Array, "b n d"]:
        x = x + self.near_out(jax.nn.gelu(self._near_tokens(jnp.where(mask[..., None], self.near_norm(x), 0.0))))
        h = self.norm(x)
        x = x + self.out(attend(self.query(h), self.key(h), self.value(h), mask[:, None], self.heads))
        return x + self.down(jax.nn.gelu(self.up(self.mlp_norm(x))))

    def _near_tokens(self, x: Float[Array, "b n d"]) -> Float[Array, "b n d"]:
        """Each feature as a weighted sum of its values at the neighbors, which are 0 beyond the ends."""
        weights, length = self.near[...], x.shape[1]
        side = len(weights) // 2
        x = jnp.pad(x, ((0, 0), (side, side), (0, 0)))
        return jnp.sum(jnp.stack([x[:, k : k + length] * weights[k][None, None] for k in range(len(weights))]), 0)


class Reader(nnx.Module):
    """Token features and numbers -> ``ReaderOutputs``."""

    def __init__(self, config: ReaderConfig, *, init: ParamInit):
        width = config.width

        def table(*shape: int, std: float = _STD) -> nnx.Param:
            return nnx.Param(init.normal(shape, std))

        self.token_norm, self.token_in = LayerNorm(config.text_width), Linear(config.text_width, width, init=init)
        self.numbers = table(config.numbers, width, std=_NUMBER_STD)
        self.blocks = nnx.List([_Block(config, init=init) for _ in range(config.blocks)])
        self.norm, self.read_norm, self.out_norm = LayerNorm(width), LayerNorm(width), LayerNorm(width)
        self.questions = table(config.named + config.ranges, width, std=1.0)
        self.query, self.key = Linear(width, width, init=init), Linear(width, width, init=init)
        self.value, self.out = Linear(width, width, init=init), Linear(width, width, init=init)
        self.up, self.down = Linear(width, 2 * width, init=init), Linear(2 * width, width, init=init)
        self.named = table(config.named, width, config.values)
        self.named_bias = nnx.Param(jnp.zeros((config.named, config.values)))
        self.low, self.high = Linear(width, width, init=init), Linear(width, width, init=init)
        self.ends = table(2, config.levels, width, std=width**-0.5)
        self.end_bias = nnx.Param(jnp.zeros((config.ranges, 2, config.levels)))
        self.config = config

    def __call__(
        self, features: Float[Array, "b n f"], numbers: Int[Array, "b n"], mask: Bool[Array, "b n"]
    ) -> ReaderOutputs:
        """The answers; padding (``mask`` False) never changes them."""
        features = jnp.where(mask[..., None], features.astype(jnp.float32), 0.0)
        x = self.token_in(self.token_norm(features)) + self.numbers[...][numbers]
        x = x + _places(features.shape[1], self.config.width)[None]
        for block in self.blocks:
            x = block(x, mask)
        x = self.norm(x)
        questions = jnp.broadcast_to(self.questions[...][None], (len(x), *self.questions.shape))
        read = attend(self.query(questions), self.key(x), self.value(x), mask[:, None], self.config.heads)
        z = questions + self.out(read)
        z = self.out_norm(z + self.down(jax.nn.gelu(self.up(self.read_norm(z)))))
        named, ranges = z[:, : self.config.named], z[:, self.config.named :]
        ends = [
            jnp.einsum("brd,nd->brn", linear(ranges), table)
            for linear, table in zip((self.low, self.high), self.ends[...], strict=True)
        ]
        return ReaderOutputs(
            named=jnp.einsum("bvd,vdc->bvc", named, self.named[...]) + self.named_bias[...][None],
            ends=jnp.stack(ends, 2) + self.end_bias[...][None],
        )


def _places(number: int, width: int) -> Float[np.ndarray, "number width"]:
    """Sines and cosines of the place of every token."""
    angles = np.arange(number)[:, None] / _LONGEST_WAVE ** (np.arange(0, width, 2) / width)[None]
    return np.concatenate([np.sin(angles), np.cos(angles)], 1).astype(np.float32) * _PLACE_SCALE


@functools.lru_cache(maxsize=4)
def reader_network(config: ReaderConfig) -> Functional:
    """The network as pure functions."""
    return functional(lambda init: Reader(config, init=init))
