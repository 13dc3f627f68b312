"""Condition features -> context tokens for lanes and agents (official-spec §4.7-4.8).

A dropped condition is the same in training and in the unconditional branch of the sampler: either a readable context
of zeros (official, ``attend_padding``), or no readable token.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.embed import image_table
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear, fused_linear
from scjax.scene.per_type import PerType
from scjax.scene.pytree import pytree

_STD = 0.02  # of tables and of the time and text MLPs
_ROW_PADDING = 16  # zeros after each text token's features


@pytree
class TextFeatures:
    """Token features of a frozen text encoder; ``mask`` is True at real tokens."""

    tokens: Float[Array | np.ndarray, "b n f"]
    mask: Bool[Array | np.ndarray, "b n"]


@pytree
class ImageFeatures:
    """Feature map of a frozen image encoder, and depth scaled to 0..1 (``normalize_depth``).

    ``present`` is False in scenes without an image, whose features are ignored; None: all scenes have one. ``mask`` is
    True at cells that are read, first those of the image, then those of the depth, row-major; None: all are.
    """

    dino: Float[Array | np.ndarray, "b channels rows columns"]
    depth: Float[Array | np.ndarray, "b height width"]
    present: Bool[Array | np.ndarray, " b"] | None = None
    mask: Bool[Array | np.ndarray, "b cells_of_both"] | None = None


ConditionFeatures = TextFeatures | ImageFeatures


class TextContext(nnx.Module):
    """One two-layer MLP for lanes and one for agents; no positions."""

    def __init__(self, config: DenoiserConfig, condition: TextCondition, *, init: ParamInit):
        def mlp(width):
            sizes = [(condition.width, width), (width, width)]
            return nnx.List([Linear(i, o, init=init, compute=config.compute, std=_STD) for i, o in sizes])

        self.agents, self.lanes = mlp(config.agent_width), mlp(config.lane_width)

    def __call__(
        self, features: TextFeatures, absent: Bool[Array, " b"], trace: dict | None = None
    ) -> tuple[PerType, Bool[Array, "b n"]]:
        """Context tokens per type, and which are real. Features of ``absent`` scenes are ignored, NaN included."""
        valid = jnp.asarray(features.mask) & ~absent[:, None]
        # The features are the largest array of a training step. Rows of 2^n bytes share a few lines of a CPU's cache;
        # with zeros after each row, the gradients of the kernels take a fifth less time (benchmarks/README.md).
        tokens = jnp.pad(jnp.asarray(features.tokens), ((0, 0), (0, 0), (0, _ROW_PADDING)))
        tokens = jnp.where(valid[..., None], tokens, 0)
        first = fused_linear([self.agents[0], self.lanes[0]], tokens, _ROW_PADDING)
        agents, lanes = (
            mlp[1](jax.nn.gelu(hidden, approximate=True))
            for mlp, hidden in zip((self.agents, self.lanes), first, strict=True)
        )
        return PerType(agents=agents, lanes=lanes), valid


class ImageContext(nnx.Module):
    """Image tokens, then depth tokens, both plus the position code of their cell; agents read a narrower copy."""

    def __init__(self, config: DenoiserConfig, condition: ImageCondition, *, init: ParamInit):
        self.dino = Linear(condition.channels, config.lane_width, init=init, compute=config.compute)
        self.depth = Linear(1, config.lane_width, init=init, compute=config.compute) if condition.depth else None
        self.agents = Linear(config.lane_width, config.agent_width, init=init, compute=config.compute)
        self.grid, self.patch = condition.grid, condition.patch

    def __call__(
        self, features: ImageFeatures, absent: Bool[Array, " b"], trace: dict | None = None
    ) -> tuple[PerType, Bool[Array, "b n"]]:
        """As ``TextContext``."""
        dino, depth = jnp.asarray(features.dino), jnp.asarray(features.depth)
        if dino.shape[1:] != (self.dino.kernel.shape[0], *self.grid):
            raise ValueError(
                f"image features have [channels, rows, columns] {dino.shape[1:]}, the network was configured for "
                f"{(self.dino.kernel.shape[0], *self.grid)}: encode images at the configured size"
            )
        dino = jnp.where(absent[:, None, None, None], 0, dino).reshape(*dino.shape[:2], -1).swapaxes(1, 2)
        code = jnp.asarray(image_table(*self.grid, self.dino.kernel.shape[1]), dino.dtype)[None]
        dino = self.dino(dino)
        if trace is not None:
            trace["dino_proj"] = dino
        lanes = dino + code
        if self.depth is not None:
            means = jnp.where(absent[:, None, None], 0, depth_cells(depth, self.grid, self.patch))
            depth = self.depth(means)
            if trace is not None:
                trace |= {"depth_patch_mean": means, "depth_proj": depth}
            lanes = jnp.concatenate([lanes, depth + code], 1)
        valid = jnp.broadcast_to(~absent[:, None], lanes.shape[:2])
        if features.mask is not None:
            valid = valid & jnp.asarray(features.mask)[:, : lanes.shape[1]]
        return PerType(agents=self.agents(lanes), lanes=lanes), valid


def normalize_depth(depth: Float[np.ndarray, "*b height width"]) -> Float[np.ndarray, "*b height width"]:
    """NaN -> 0, then each map scaled to 0..1 by its own minimum and maximum (NumPy, when features are stored)."""
    depth = np.nan_to_num(depth, nan=0.0, posinf=None, neginf=None)
    low, high = (f(depth, axis=(-2, -1), keepdims=True) for f in (np.min, np.max))
    return (depth - low) / (high - low + 1e-8)


def depth_cells(depth: Float[Array, "b height width"], grid: tuple[int, int], patch: int) -> Float[Array, "b cells 1"]:
    """Means over patch x patch pixels of the map resized to [patch rows, patch columns] (spec §4.8), row-major.

    Resizing (bilinear, half-pixel centers, two taps per axis: no antialiasing) and averaging together are one small
    matrix per axis; the resized map itself is never computed. ``patch`` 1 gives it.
    """
    rows, columns = (
        jnp.asarray(_two_taps(size, cells * patch).reshape(cells, patch, size).mean(1), depth.dtype)
        for size, cells in zip(depth.shape[1:], grid, strict=True)
    )
    return jnp.einsum("rh,bhw,cw->brc", rows, depth, columns).reshape(len(depth), -1, 1)


@functools.cache
def _two_taps(size: int, target: int) -> np.ndarray:
    """Matrix [target, size] whose row i has the two weights of output pixel i (official-spec §4.8)."""
    position = np.clip((np.arange(target) + 0.5) * (size / target) - 0.5, 0, size - 1)
    low = np.minimum(np.floor(position).astype(int), size - 1)
    high = np.minimum(low + 1, size - 1)
    weights = np.zeros((target, size))
    np.add.at(weights, (np.arange(target), low), 1 - (position - low))
    np.add.at(weights, (np.arange(target), high), position - low)
    return weights
