"""Deformable attention (Zhu et al. 2021, arXiv:2010.04159; attention-variants §4.8).

Each query predicts a position in the context and samples values at a few learned offsets around it. There are no keys.
On an image the grids of its modalities are the levels, sampled bilinearly; along a text the sampling is linear.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.attention import merge_heads, split_heads
from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import (
    AuxOutputs,
    ContextSpec,
    CrossAttentionOptions,
    Work,
    active_rows,
    at_least,
    mask_rows,
)
from scjax.nn.cross_attention.gathered import rows_at
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear
from scjax.scene.pytree import pytree


@dataclasses.dataclass(frozen=True)
class DeformableOptions(CrossAttentionOptions):
    """Options of ``Deformable``: ``points`` sampled per head and level."""

    name: ClassVar[str] = "deformable"

    points: int = 4

    def __post_init__(self):
        at_least(self, points=1)

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> Deformable:
        """The module of this mechanism."""
        return Deformable(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        axes, samples = (1 if spec.grid is None else 2), heads * spec.modalities * self.points
        predict = queries * width * (axes + (axes + 1) * samples)
        read = queries * 2**axes * spec.modalities * self.points * width
        return Work(context * width**2, queries * width**2 + predict + read)


@pytree
class Values:
    """Values by head, zero at masked tokens."""

    value: Float[Array, "b h m d"]
    mask: Bool[Array, "b m"]


class Deformable(nnx.Module):
    """y = W_o sum of A V(p + offset) over levels and points, with p, offsets and weights A from the query."""

    def __init__(
        self,
        options: DeformableOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
        self.axes = 1 if spec.grid is None else 2
        samples = heads * spec.modalities * options.points
        self.v, self.out = (Linear(width, width, init=init, compute=compute) for _ in range(2))
        # Positions and weights stay in float32: bfloat16 resolves a grid of 14 cells to 0.06.
        self.reference = Linear(width, self.axes, init=init)
        self.offsets = Linear(width, samples * self.axes, init=init, std=0.0)
        self.offsets.bias = nnx.Param(jnp.asarray(ring_offsets(heads, spec.modalities, options.points, self.axes)))
        self.weights = Linear(width, samples, init=init, std=0.0)
        self.heads, self.spec, self.points = heads, spec, options.points

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Values:
        """The values."""
        value = mask_rows(mask, self.v(mask_rows(mask, context)))
        return Values(value=split_heads(value, self.heads), mask=mask)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Values
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens sample."""
        x = mask_rows(x_mask, x)
        shape = (*x_mask.shape, self.heads, self.spec.modalities * self.points)
        weights = jax.nn.softmax(self.weights(x).reshape(shape), -1)
        extent = cache.mask.sum(-1).astype(x.dtype)[:, None, None]  # [b 1 1]
        if self.spec.grid is not None:
            rows, columns = self.spec.grid
            extent = jnp.asarray([columns, rows], x.dtype)[None, None]
        center = jax.nn.sigmoid(self.reference(x)) * extent - 0.5
        position = center[:, :, None, None] + self.offsets(x).reshape(*shape, self.axes)
        level = jnp.repeat(jnp.arange(self.spec.modalities), self.points)
        attended = sample_values(cache.value, cache.mask, position, weights, level, self.spec)
        return mask_rows(active_rows(x_mask, cache.mask), self.out(merge_heads(attended))), AuxOutputs()


def sample_values(
    value: Float[Array, "b h m d"],
    mask: Bool[Array, "b m"],
    position: Float[Array, "b n h k axes"],
    weights: Float[Array, "b n h k"],
    level: Array,
    spec: ContextSpec,
) -> Float[Array, "b h n d"]:
    """Sum over samples k of weight times the value at a position, interpolated linearly along each axis.

    Args:
      position: in cells, (column, row) on a grid; whole numbers are cell centers. Values outside the grid, or after
        the last token of a text, are zero.
      level: the modality of each sample [k].
    """
    low = jnp.floor(position)
    part = position - low
    sizes = (spec.grid[1], spec.grid[0]) if spec.grid is not None else (mask.shape[1],)
    valid_cells = mask.sum(-1)[:, None, None, None]
    indices, shares = [], []
    for corner in itertools.product((0, 1), repeat=position.shape[-1]):
        cell, share, index = low + jnp.asarray(corner, low.dtype)[None, None, None, None], weights, 0
        inside = jnp.ones(weights.shape, bool)
        for axis in reversed(range(len(sizes))):  # the slowest first
            along = cell[..., axis]
            end = valid_cells if spec.grid is None else sizes[axis]
            inside = inside & (along >= 0) & (along < end)
            share = share * (part[..., axis] if corner[axis] else 1 - part[..., axis])
            index = index * sizes[axis] + jnp.clip(along, 0, sizes[axis] - 1).astype(jnp.int32)
        indices.append(index + math.prod(sizes) * level[None, None, None])
        shares.append(jnp.where(inside, share, 0))
    index, share = (jnp.concatenate(parts, -1).swapaxes(1, 2) for parts in (indices, shares))  # [b h n 4k]
    return jnp.einsum("bhnk,bhnkd->bhnd", share, rows_at(value, index))


def ring_offsets(heads: int, levels: int, points: int, axes: int) -> Float[np.ndarray, " offsets"]:
    """Initial offsets in cells: point k of a head lies k steps in the head's direction, on every level.

    Directions divide the circle and are scaled onto a square; along one axis they alternate in sign.
    """
    angle = 2 * np.pi * np.arange(heads) / heads
    direction = np.stack([np.cos(angle), np.sin(angle)], -1)
    direction = direction / np.abs(direction).max(-1, keepdims=True)
    if axes == 1:
        direction = np.where(np.arange(heads) % 2, -1.0, 1.0)[:, None]
    steps = np.arange(1, points + 1)[None, None, :, None]
    offsets = np.broadcast_to(direction[:, None, None] * steps, (heads, levels, points, axes))
    return offsets.reshape(-1).astype(np.float32)
