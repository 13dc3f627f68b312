"""Vision transformers with LayerScale: DINOv2 (Oquab et al. 2023), its variant with registers, and DINOv3 (2025).

One block serves all. They differ in how patches get their places: DINOv2 adds a learned table, DINOv3 rotates queries
and keys. Activations, norms and attention are float32; ``compute`` is the precision of products with the weights.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Annotated

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from einops import rearrange
from flax import nnx
from jaxtyping import Array, Float

from scjax.encoders.base import Epsilon, Layers, Size
from scjax.encoders.resize import antialias_matrix, bicubic_matrix
from scjax.nn.attention import attend_heads, merge_heads, split_heads
from scjax.nn.cpu.precision import Compute, check_compute
from scjax.nn.init import ParamInit
from scjax.nn.layers import LayerNorm, Linear

_STD = 0.02
_ROTATION_PARTS = 4  # sines and cosines of rows and of columns

PatchSize = Annotated[int, msgspec.Meta(ge=1, le=256)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class VitConfig:
    """Sizes and variants, named as in ``config.json`` of the transformers library where it has them.

    Attributes:
      image_size: side [pixels] of the square images whose patches the table of positions has.
      num_register_tokens: learned tokens after the class token that stand for no patch.
      rope_theta: largest wavelength ratio of rotary positions; None: a learned table of positions.
      antialias_positions: whether a table that shrinks is smoothed (DINOv2 with registers).
      compute: precision of products with the weights.
    """

    hidden_size: Size = 384
    num_hidden_layers: Layers = 12
    num_attention_heads: Size = 6
    intermediate_size: Size = 1536
    patch_size: PatchSize = 14
    image_size: Size = 518
    layer_norm_eps: Epsilon = 1e-6
    num_register_tokens: Annotated[int, msgspec.Meta(ge=0, le=1024)] = 0
    query_bias: bool = True
    key_bias: bool = True
    value_bias: bool = True
    rope_theta: Annotated[float, msgspec.Meta(gt=1, le=1e9)] | None = None
    antialias_positions: bool = False
    compute: Compute = "float32"

    def __post_init__(self):
        check_compute(self.compute)
        if self.hidden_size % self.num_attention_heads:
            raise ValueError(
                f"hidden_size {self.hidden_size} is no multiple of num_attention_heads {self.num_attention_heads}"
            )
        head_size = self.hidden_size // self.num_attention_heads
        if self.rope_theta is not None and head_size % _ROTATION_PARTS:
            raise ValueError(f"heads of {head_size} numbers have no rotary positions: they need a multiple of 4")
        if self.rope_theta is None and self.image_size < self.patch_size:
            raise ValueError(f"image_size {self.image_size} is less than patch_size {self.patch_size}")

    def with_compute(self, compute: Compute) -> VitConfig:
        """The same sizes in another precision."""
        return dataclasses.replace(self, compute=compute)

    @property
    def width(self) -> int:
        """Features of a patch."""
        return self.hidden_size

    @property
    def table_side(self) -> int:
        """Rows, and columns, of the learned table of positions."""
        return self.image_size // self.patch_size

    @property
    def num_prefix_tokens(self) -> int:
        """Tokens that stand for no patch: the class token and the registers."""
        return 1 + self.num_register_tokens


Rotation = tuple[np.ndarray, np.ndarray]
"""Cosines and sines [patches, head size] of every patch's place."""


class VitBlock(nnx.Module):
    """x = x + scale1 attention(norm1(x)), x = x + scale2 MLP(norm2(x))."""

    def __init__(self, config: VitConfig, *, init: ParamInit):
        width, inner, eps = config.hidden_size, config.intermediate_size, config.layer_norm_eps
        linear = functools.partial(Linear, init=init, std=_STD, compute=config.compute)
        self.norm1, self.norm2 = LayerNorm(width, eps), LayerNorm(width, eps)
        self.query = linear(width, width, bias=config.query_bias)
        self.key = linear(width, width, bias=config.key_bias)
        self.value = linear(width, width, bias=config.value_bias)
        self.out = linear(width, width)
        self.up, self.down = linear(width, inner), linear(inner, width)
        self.scale1, self.scale2 = nnx.Param(jnp.ones(width)), nnx.Param(jnp.ones(width))
        self.heads = config.num_attention_heads

    def __call__(self, x: Float[Array, "b t d"], rotation: Rotation | None) -> Float[Array, "b t d"]:
        normed = self.norm1(x)
        q, k, v = (split_heads(part(normed), self.heads) for part in (self.query, self.key, self.value))
        if rotation is not None:
            q, k = _rotate(q, rotation), _rotate(k, rotation)
        attended = self.out(merge_heads(attend_heads(q, k, v, None)))
        x = x + self.scale1[...][None, None] * attended
        inner = jax.nn.gelu(self.up(self.norm2(x)), approximate=False)
        return x + self.scale2[...][None, None] * self.down(inner)


class Vit(nnx.Module):
    """Images -> features of their patches."""

    def __init__(self, config: VitConfig, *, init: ParamInit):
        width = config.hidden_size
        self.patches = Linear(3 * config.patch_size**2, width, init=init, compute=config.compute, std=_STD)
        self.class_token = nnx.Param(init.normal((1, width), _STD))
        registers = config.num_register_tokens
        self.registers = nnx.Param(init.normal((registers, width), _STD)) if registers else None
        places = 1 + config.table_side**2
        self.positions = nnx.Param(init.normal((places, width), _STD)) if config.rope_theta is None else None
        self.layers = nnx.List([VitBlock(config, init=init) for _ in range(config.num_hidden_layers)])
        self.norm = LayerNorm(width, config.layer_norm_eps)
        self.config = config

    def __call__(self, pixels: Float[Array, "b height width 3"]) -> Float[Array, "b patches d"]:
        """Features of every patch after the last layer and norm, row-major.

        Raises:
          ValueError: height or width is no multiple of the patch size.
        """
        return self.features(pixels, (self.config.num_hidden_layers,))[0]

    def features(
        self, pixels: Float[Array, "b height width 3"], layers: tuple[int, ...]
    ) -> list[Float[Array, "b patches d"]]:
        """Features of every patch after each of these layers (1 is the first) and the last norm."""
        x, rotation = self._embed(pixels)
        results: dict[int, Array] = {}
        for number, layer in enumerate(list(self.layers)[: max(layers)], 1):
            x = layer(x, rotation)
            if number in layers:
                results[number] = self.norm(x)[:, self.config.num_prefix_tokens :]
        return [results[number] for number in layers]

    def _embed(self, pixels: Float[Array, "b height width 3"]) -> tuple[Float[Array, "b t d"], Rotation | None]:
        """All tokens, with their learned positions, or the rotation that replaces these."""
        config = self.config
        rows, columns = patch_grid(pixels.shape[1], pixels.shape[2], config.patch_size)
        size = config.patch_size
        cells = rearrange(pixels, "b (r u) (c v) k -> b (r c) (u v k)", u=size, v=size)
        patches, prefix = self.patches(cells), self.class_token[...]
        rotation = None
        if self.positions is not None:
            prefix = prefix + self.positions[...][:1]
            patches = patches + self._table(rows, columns)[None]
        elif config.rope_theta is not None:
            rotation = _rotation(rows, columns, config.hidden_size // config.num_attention_heads, config.rope_theta)
        if self.registers is not None:
            prefix = jnp.concatenate([prefix, self.registers[...]])
        prefix = jnp.broadcast_to(prefix[None], (len(pixels), *prefix.shape))
        return jnp.concatenate([prefix, patches], 1), rotation

    def _table(self, rows: int, columns: int) -> Float[Array, "patches d"]:
        """The learned table at another number of rows and columns."""
        assert self.positions is not None
        side = self.config.table_side
        if self.config.antialias_positions:
            by_row, by_column = (antialias_matrix(side, number, "cubic") for number in (rows, columns))
        else:
            by_row, by_column = (bicubic_matrix(side, number) for number in (rows, columns))
        table = self.positions[...][1:].reshape(side, side, -1)
        return jnp.einsum("rh,hwd,cw->rcd", by_row, table, by_column).reshape(rows * columns, -1)


def patch_grid(height: int, width: int, patch_size: int) -> tuple[int, int]:
    """Rows and columns of patches of an image.

    Raises:
      ValueError: height or width is no positive multiple of the patch size.
    """
    if height % patch_size or width % patch_size or not height or not width:
        raise ValueError(
            f"an image of {height} x {width} pixels has no whole patches of {patch_size} x {patch_size}: resize it "
            "with scjax.encoders.prepare_image"
        )
    return height // patch_size, width // patch_size


@functools.lru_cache(maxsize=32)
def _rotation(rows: int, columns: int, head_size: int, theta: float) -> Rotation:
    """Angles of patch centers, -1..1 in each axis: the frequencies of rows, those of columns, and both again."""
    number = head_size // _ROTATION_PARTS
    frequencies = theta ** -(np.arange(number) / number)
    centers = np.meshgrid(*(2 * (np.arange(n) + 0.5) / n - 1 for n in (rows, columns)), indexing="ij")
    angles = 2 * np.pi * np.stack(centers, -1).reshape(-1, 2, 1) * frequencies
    angles = np.tile(angles.reshape(rows * columns, -1), (1, 2))
    return np.cos(angles).astype(np.float32), np.sin(angles).astype(np.float32)


def _rotate(x: Float[Array, "b h t d"], rotation: Rotation) -> Float[Array, "b h t d"]:
    """Rotates the last tokens, those of patches: each number of the first half with its partner in the second."""
    cos, sin = (jnp.asarray(part)[None, None] for part in rotation)
    start = x.shape[2] - cos.shape[2]
    prefix, patches = x[:, :, :start], x[:, :, start:]
    first, second = jnp.split(patches, 2, -1)
    turned = jnp.concatenate([-second, first], -1)
    return jnp.concatenate([prefix, patches * cos + turned * sin], 2)
