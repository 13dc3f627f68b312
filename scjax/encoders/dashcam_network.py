"""The vision network that comes with scjax: a small one that learned from rendered dashcam pictures alone.

Convolutions on fine cells, attention on coarse ones, then fine cells again. Every fine cell says in plain numbers what
it shows: classes, depth, the object and the lane there, with their places. The tokens of the coarse cells are these
numbers of their fine cells, with sines and cosines of the places, and features of the attention.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from scjax.encoders.base import Layers, Size
from scjax.nn.attention import attend_heads, merge_heads, split_heads
from scjax.nn.cpu.precision import Compute, check_compute
from scjax.nn.init import ParamInit
from scjax.nn.layers import LayerNorm, Linear

CLASSES = 13  # of camera.dashcam.materials.SemanticClass
FINE = 2  # fine cells to each side of a token
NUMBERS = {"classes": CLASSES, "depth": 1, "object": 7, "lane": 6}
"""Of a fine cell; the last of an object and of a lane is the logit that there is one."""

PLACE_SCALE = 32.0
"""Meters of a unit of places."""

_WAVELENGTHS = (128.0, 32.0, 8.0)  # m
_CELL_WIDTH = sum(NUMBERS.values()) + 2 * 4 * len(_WAVELENGTHS)  # of a fine cell in a token

_PATCH = 16


class FineCells(NamedTuple):
    """What fine cells show; places are in the frame of the ego, by ``PLACE_SCALE``.

    Attributes:
      classes: logits.
      depth: logarithm of the depth [m].
      objects: x, y, cosine and sine of the heading, length / 10, width / 10, logit of being there.
      lanes: x, y, cosine and sine of the direction, distance to the left of the lane / 4, logit of being there.
    """

    classes: Float[Array, "b rows columns 13"]
    depth: Float[Array, "b rows columns"]
    objects: Float[Array, "b rows columns 7"]
    lanes: Float[Array, "b rows columns 6"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class DashcamConfig:
    """Sizes of the network, as in its ``config.json``.

    Attributes:
      stem: channels of cells of 4 x 4 pixels.
      fine, fine_layers: channels and layers of cells of 8 x 8 pixels, before the attention and again after it.
      hidden_size, layers, heads: of the attention between cells of 16 x 16 pixels.
      features: numbers that tokens take from the attention, besides those of their fine cells.
    """

    stem: Size = 48
    fine: Size = 96
    fine_layers: Layers = 3
    hidden_size: Size = 192
    layers: Layers = 2
    heads: Size = 6
    features: Size = 64
    rows: Size = 14
    columns: Size = 14
    compute: Compute = "float32"

    def __post_init__(self):
        check_compute(self.compute)
        if self.hidden_size % self.heads:
            raise ValueError(f"hidden_size {self.hidden_size} is no multiple of heads {self.heads}")

    def with_compute(self, compute: Compute) -> DashcamConfig:
        """The same sizes in another precision."""
        return dataclasses.replace(self, compute=compute)

    @property
    def width(self) -> int:
        """Numbers of a token."""
        return self.features + FINE**2 * _CELL_WIDTH

    @property
    def patch_size(self) -> int:
        """Side of a token's cell [pixels]."""
        return _PATCH


class DashcamNetwork(nnx.Module):
    """Pictures, as encoders expect their pixels -> tokens."""

    def __init__(self, config: DashcamConfig, *, init: ParamInit):
        def linear(size_in: int, size_out: int) -> Linear:
            return Linear(size_in, size_out, init=init, compute=config.compute)

        def layers():
            return nnx.List(
                [LocalLayer(config.fine, init=init, compute=config.compute) for _ in range(config.fine_layers)]
            )

        width, fine = config.hidden_size, config.fine
        self.stem = linear(48, config.stem)
        self.to_fine = linear(4 * config.stem, fine)
        self.first, self.last = layers(), layers()
        self.to_coarse = linear(4 * fine, width)
        self.positions = nnx.Param(init.normal((config.rows * config.columns, width), 0.02))
        self.attention = nnx.List(
            [AttentionLayer(width, config.heads, init=init, compute=config.compute) for _ in range(config.layers)]
        )
        self.from_coarse = linear(width, 4 * fine)
        self.numbers_norm = LayerNorm(fine)
        self.numbers = linear(fine, sum(NUMBERS.values()))
        self.features_norm = LayerNorm(width)
        self.features = linear(width, config.features)
        self.config = config

    def __call__(self, pixels: Float[Array, "b height width 3"]) -> Float[Array, "b tokens features"]:
        """Tokens of the cells, row-major."""
        cells, features = self._cells(pixels)
        return jnp.concatenate([features, _joined(_with_places(cells)).reshape(*features.shape[:2], -1)], -1)

    def cells(self, pixels: Float[Array, "b height width 3"]) -> FineCells:
        """What the fine cells show."""
        classes, depth, objects, lanes = _parts(self._cells(pixels)[0])
        return FineCells(classes, depth[..., 0], objects, lanes)

    def depth(self, pixels: Float[Array, "b height width 3"]) -> Float[Array, "b rows columns"]:
        """Depth of the fine cells [m]."""
        return jnp.exp(self.cells(pixels).depth)

    def _cells(self, pixels: Array) -> tuple[Array, Array]:
        """Numbers of the fine cells, and features of the tokens."""
        x = jax.nn.gelu(self.stem(_joined(_joined(pixels))), approximate=True)
        x = self.to_fine(_joined(x))
        for layer in self.first:
            x = layer(x)
        coarse = self.to_coarse(_joined(x))
        tokens = coarse.reshape(len(x), -1, coarse.shape[-1]) + self.positions[...][None]
        for layer in self.attention:
            tokens = layer(tokens)
        x = x + _split(self.from_coarse(tokens.reshape(coarse.shape)))
        for layer in self.last:
            x = layer(x)
        return self.numbers(self.numbers_norm(x)), self.features(self.features_norm(tokens))


class LocalLayer(nnx.Module):
    """x + MLP(the 3 x 3 cells around, each as a few numbers)."""

    def __init__(self, width: int, *, init: ParamInit, compute: Compute):
        few = width // 4
        self.norm = LayerNorm(width)
        self.few = Linear(width, few, init=init, compute=compute)
        self.up = Linear(9 * few, 2 * width, init=init, compute=compute)
        self.down = Linear(2 * width, width, init=init, compute=compute)

    def __call__(self, x: Float[Array, "b h w d"]) -> Float[Array, "b h w d"]:
        around = _neighborhoods(self.few(self.norm(x)))
        return x + self.down(jax.nn.gelu(self.up(around), approximate=True))


class AttentionLayer(nnx.Module):
    """x + attention(norm(x)), then x + MLP(norm(x))."""

    def __init__(self, width: int, heads: int, *, init: ParamInit, compute: Compute):
        def linear(size_in: int, size_out: int) -> Linear:
            return Linear(size_in, size_out, init=init, compute=compute)

        self.norm1, self.norm2 = LayerNorm(width), LayerNorm(width)
        self.q, self.k, self.v, self.out = (linear(width, width) for _ in range(4))
        self.up, self.down = linear(width, 4 * width), linear(4 * width, width)
        self.heads = heads

    def __call__(self, x: Float[Array, "b n d"]) -> Float[Array, "b n d"]:
        read = self.norm1(x)
        q, k, v = (split_heads(layer(read), self.heads) for layer in (self.q, self.k, self.v))
        x = x + self.out(merge_heads(attend_heads(q, k, v, None)))
        return x + self.down(jax.nn.gelu(self.up(self.norm2(x)), approximate=True))


def cells_of_tokens(tokens: Float[np.ndarray, "tokens width"]) -> dict[str, Float[np.ndarray, "cells _"]]:
    """The ``NUMBERS`` of all fine cells in tokens, by name; in the order of the tokens."""
    cells = tokens[:, -(FINE**2) * _CELL_WIDTH :].reshape(-1, _CELL_WIDTH)
    parts = np.split(cells, np.cumsum(list(NUMBERS.values())), axis=1)
    return dict(zip(NUMBERS, parts, strict=False))


def sureness(logits: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "*b"]:
    """How sure cells are that they show an object or a lane, from 0 to 1."""
    return 1 / (1 + np.exp(-logits.clip(-30, 30)))


def _parts(numbers: Array) -> list[Array]:
    return jnp.split(numbers, np.cumsum(list(NUMBERS.values()))[:-1].tolist(), -1)


def _with_places(numbers: Array) -> Array:
    """The numbers of fine cells, and sines and cosines of the places of objects and lanes, by how sure they are."""
    _, _, objects, lanes = _parts(numbers)
    codes = []
    for found in (objects, lanes):
        places = PLACE_SCALE * found[..., :2]
        angles = jnp.concatenate([places * (2 * np.pi / wavelength) for wavelength in _WAVELENGTHS], -1)
        sure = jax.nn.sigmoid(found[..., -1:])
        codes += [sure * jnp.sin(angles), sure * jnp.cos(angles)]
    return jnp.concatenate([numbers, *codes], -1)


def _joined(x: Float[Array, "b h w d"]) -> Array:
    """2 x 2 cells as one."""
    batch, height, width, depth = x.shape
    x = x.reshape(batch, height // 2, 2, width // 2, 2, depth).swapaxes(2, 3)
    return x.reshape(batch, height // 2, width // 2, 4 * depth)


def _split(x: Float[Array, "b h w d"]) -> Array:
    """The inverse of ``_joined``."""
    batch, height, width, depth = x.shape
    x = x.reshape(batch, height, width, 2, 2, depth // 4).swapaxes(2, 3)
    return x.reshape(batch, 2 * height, 2 * width, depth // 4)


def _neighborhoods(x: Float[Array, "b h w d"]) -> Array:
    """The 3 x 3 cells around each cell, as one."""
    height, width = x.shape[1:3]
    padded = jnp.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
    parts = [padded[:, row : row + height, column : column + width] for row in range(3) for column in range(3)]
    return jnp.concatenate(parts, -1)
