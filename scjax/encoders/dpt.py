"""Depth Anything V2 (Yang et al. 2024): a DINOv2 with the head of a dense prediction transformer (Ranftl et al. 2021).

The patches of four layers become maps of four sizes, which are fused from the coarsest to the finest.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import msgspec
from flax import nnx
from jaxtyping import Array, Float

from scjax.encoders.base import Size
from scjax.encoders.resize import bilinear_matrix
from scjax.encoders.vit import Vit, VitConfig, patch_grid
from scjax.nn.convolution import Conv, PixelExpansion
from scjax.nn.cpu.precision import Compute
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear

Factor = Annotated[float, msgspec.Meta(gt=0, le=64)]
DepthType = Literal["relative", "metric"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class DepthConfig:
    """Sizes, named as in ``config.json`` of the transformers library.

    Attributes:
      layers: of the transformer, whose patches are read; 1 is the first.
      reassemble_factors: size of each map over that of the grid of patches: whole numbers, or one over them.
      neck_hidden_sizes: channels of each map.
      depth_estimation_type: "relative" networks give inverse depth without a scale, "metric" ones give meters.
      max_depth: what the result is multiplied by.
    """

    backbone: VitConfig
    layers: tuple[int, ...] = (3, 6, 9, 12)
    reassemble_factors: tuple[Factor, ...] = (4.0, 2.0, 1.0, 0.5)
    neck_hidden_sizes: tuple[Size, ...] = (48, 96, 192, 384)
    fusion_hidden_size: Size = 64
    head_hidden_size: Size = 32
    depth_estimation_type: DepthType = "relative"
    max_depth: Annotated[float, msgspec.Meta(gt=0, le=1e6)] = 1.0

    def __post_init__(self):
        if not len(self.layers) == len(self.reassemble_factors) == len(self.neck_hidden_sizes) > 0:
            raise ValueError(
                f"{len(self.layers)} layers, {len(self.reassemble_factors)} reassemble_factors and "
                f"{len(self.neck_hidden_sizes)} neck_hidden_sizes must be equally many"
            )
        most = self.backbone.num_hidden_layers
        if not all(1 <= layer <= most for layer in self.layers):
            raise ValueError(f"the head reads layers {list(self.layers)}, but the transformer has {most}")
        for factor in self.reassemble_factors:
            if factor != int(factor) and 1 / factor != int(1 / factor):
                raise ValueError(f"reassemble_factors has {factor}: only whole numbers and one over them are supported")

    def with_compute(self, compute: Compute) -> DepthConfig:
        """The same sizes in another precision."""
        return dataclasses.replace(self, backbone=self.backbone.with_compute(compute))

    @property
    def compute(self) -> Compute:
        """Precision of products with the weights."""
        return self.backbone.compute


class Reassemble(nnx.Module):
    """Features of patches -> a map of ``channels``, ``factor`` times as large."""

    def __init__(self, config: DepthConfig, channels: int, factor: float, *, init: ParamInit):
        compute = config.backbone.compute
        self.projection = Linear(config.backbone.hidden_size, channels, init=init, compute=compute)
        if factor > 1:
            self.resize = PixelExpansion(channels, channels, int(factor), init=init, compute=compute)
        elif factor < 1:
            self.resize = Conv(channels, channels, 3, stride=int(1 / factor), init=init, compute=compute)
        else:
            self.resize = None

    def __call__(self, x: Float[Array, "b rows columns d"]) -> Float[Array, "b h w c"]:
        x = self.projection(x)
        return x if self.resize is None else self.resize(x)


class ResidualUnit(nnx.Module):
    """x + conv(relu(conv(relu(x))))."""

    def __init__(self, channels: int, conv: functools.partial):
        self.first, self.second = conv(channels, channels, 3), conv(channels, channels, 3)

    def __call__(self, x: Float[Array, "b h w c"]) -> Float[Array, "b h w c"]:
        return x + self.second(jax.nn.relu(self.first(jax.nn.relu(x))))


class Fusion(nnx.Module):
    """Adds a map to a coarser one and enlarges the sum; the coarsest is alone."""

    def __init__(self, channels: int, conv: functools.partial, *, has_skip: bool):
        self.skip = ResidualUnit(channels, conv) if has_skip else None
        self.unit = ResidualUnit(channels, conv)
        self.projection = conv(channels, channels, 1)

    def __call__(
        self, x: Float[Array, "b h w c"], skip: Float[Array, "b h2 w2 c"] | None, rows: int, columns: int
    ) -> Float[Array, "b rows columns c"]:
        if skip is not None and self.skip is not None:
            if skip.shape != x.shape:
                skip = _resized(skip, x.shape[1], x.shape[2], align_corners=False)
            x = x + self.skip(skip)
        return self.projection(_resized(self.unit(x), rows, columns, align_corners=True))


class DepthNetwork(nnx.Module):
    """Images -> inverse depth ("relative") or depth [m] ("metric") of every pixel."""

    def __init__(self, config: DepthConfig, *, init: ParamInit):
        compute, width = config.backbone.compute, config.fusion_hidden_size
        conv = functools.partial(Conv, init=init, compute=compute)
        self.backbone = Vit(config.backbone, init=init)
        sizes = list(zip(config.neck_hidden_sizes, config.reassemble_factors, strict=True))
        self.reassemble = nnx.List([Reassemble(config, channels, factor, init=init) for channels, factor in sizes])
        self.convs = nnx.List([conv(channels, width, 3, bias=False) for channels, _ in sizes])
        self.fusions = nnx.List([Fusion(width, conv, has_skip=number > 0) for number in range(len(sizes))])
        self.head = nnx.List(
            [
                conv(width, width // 2, 3),
                conv(width // 2, config.head_hidden_size, 3),
                conv(config.head_hidden_size, 1, 1),
            ]
        )
        self.config = config

    def __call__(self, pixels: Float[Array, "b height width 3"]) -> Float[Array, "b height width"]:
        """Raises ValueError if height or width is no multiple of the patch size."""
        config = self.config
        height, width = pixels.shape[1:3]
        rows, columns = patch_grid(height, width, config.backbone.patch_size)
        features = self.backbone.features(pixels, config.layers)
        grids = [one.reshape(len(one), rows, columns, -1) for one in features]
        maps = [
            conv(reassemble(grid)) for grid, reassemble, conv in zip(grids, self.reassemble, self.convs, strict=True)
        ][::-1]
        x, skip = maps[0], None
        for number, fusion in enumerate(self.fusions):
            skip = maps[number] if number else None
            size = maps[number + 1].shape[1:3] if number + 1 < len(maps) else (2 * x.shape[1], 2 * x.shape[2])
            x = fusion(x, skip, *size)
        x = _resized(self.head[0](x), height, width, align_corners=True)
        x = self.head[2](jax.nn.relu(self.head[1](x)))[..., 0]
        x = jax.nn.relu(x) if config.depth_estimation_type == "relative" else jax.nn.sigmoid(x)
        return x * config.max_depth


def _resized(
    x: Float[Array, "b h w c"], rows: int, columns: int, *, align_corners: bool
) -> Float[Array, "b rows columns c"]:
    by_row = bilinear_matrix(x.shape[1], rows, align_corners=align_corners)
    by_column = bilinear_matrix(x.shape[2], columns, align_corners=align_corners)
    return jnp.einsum("ph,bhwc,qw->bpqc", by_row, x, by_column)
