"""Where depth comes from, and its tokens: means of cells, scaled to 0..1 by the picture's own least and greatest.

A provider is called with a photo. The sources are files, a network, a renderer's exact depth, and none. Scales and
units are lost in the tokens (as in the paper), so that all of them serve one model.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32

from scjax.camera.photo import Photo
from scjax.encoders import dashcam_weights, dpt_weights
from scjax.encoders.base import PublishedNetwork
from scjax.encoders.dashcam_depth import DashcamDepth
from scjax.encoders.hub_folder import find_network_folder
from scjax.encoders.image_network import LoadedNetwork, compiled_network, load_network, run_padded
from scjax.encoders.preprocessing import Preprocessing, cell_matrices, normalized_pixels, real_cells
from scjax.encoders.vision import GridTokens
from scjax.nn.cpu.precision import Compute, operands
from scjax.scene.arguments import whole_number

DEPTH_NETWORKS: dict[str, PublishedNetwork] = {
    "depth_anything": dpt_weights.NETWORK,
    dashcam_weights.MODEL_TYPE: dashcam_weights.NETWORK,
}
"""``model_type`` of a ``config.json`` -> the network that reads such folders."""

DEPTH_VERSION = 1
"""Changes whenever depth tokens change: tokens that are kept elsewhere are then made anew."""

FAR_RATIO = 50.0
"""Largest depth over the smallest one, where depth is the inverse of a network's result, which may be 0 in the sky."""

MAX_DEPTH = 80.0
"""Depths beyond this are this [m], where depth has a unit."""

_MOST_ASPECT = 4.0  # longer sides over shorter ones that a depth network gets; pictures beyond are squeezed

DepthMap = Float[np.ndarray, "height width"]
"""Depth of the whole picture at any resolution; NaN where it is not known."""


@runtime_checkable
class DepthProvider(Protocol):
    """Depth of photos. ``key_of`` differs between providers whose depths of the photo differ."""

    def key_of(self, photo: Photo) -> str:
        """What the depth of the photo depends on, besides its pixels."""
        ...

    def __call__(self, photo: Photo) -> DepthMap | None:
        """Depth along the camera's axis, in any unit; None: there is none."""
        ...


class NoDepth:
    """No depth: tokens are zero and masked."""

    def key_of(self, photo: Photo) -> str:
        return "none"

    def __call__(self, photo: Photo) -> None:
        return None


class ExactDepth:
    """The depth that a renderer made together with the picture.

    Args:
      depth: [height, width] in meters, inf in the sky, NaN where it is not known.

    Raises:
      ValueError: it is no such array.
    """

    def __init__(self, depth: Any):
        self.depth = np.minimum(check_depth(depth, "depth"), MAX_DEPTH)

    def key_of(self, photo: Photo) -> str:
        """The hash of the depth."""
        return f"exact-{hashlib.sha256(f'{self.depth.shape}'.encode() + self.depth.tobytes()).hexdigest()[:24]}"

    def __call__(self, photo: Photo) -> DepthMap:
        return self.depth


class FrozenDepthNetwork:
    """A depth network with its weights.

    Args:
      shorter_side: of the pictures that the network gets [pixels]; Depth Anything was trained with 518. Less is faster.
    """

    def __init__(self, loaded: LoadedNetwork, shorter_side: int = 518):
        self.config, self.params, self.name = loaded.config, loaded.params, loaded.name
        patch_size = self.config.backbone.patch_size
        self.shorter_side = whole_number(shorter_side, "shorter_side", patch_size, 2048)
        self._program = compiled_network(loaded.network, loaded.config)

    def key_of(self, photo: Photo) -> str:
        """Name, size and precision."""
        return f"{self.name}-{self.shorter_side}-{operands(self.config.compute)}"

    def __call__(self, photo: Photo) -> Float32[np.ndarray, "height width"]:
        """Depth; without a unit where the network estimates inverse depth.

        Raises:
          ValueError: depth that is not finite, as of damaged weights.
        """
        estimate = self.estimate(photo)
        if self.config.depth_estimation_type == "metric":
            return np.minimum(estimate, np.float32(MAX_DEPTH))
        return from_inverse(estimate)

    def estimate(self, photo: Photo) -> Float32[np.ndarray, "height width"]:
        """What the network itself gives: inverse depth without a scale, or meters."""
        rows, columns = self.input_size(photo.size)
        pixels = normalized_pixels(photo, rows, columns, "cubic")
        estimate = run_padded(self._program, self.params, [pixels])[0]
        if not np.isfinite(estimate).all():
            raise ValueError(f"the depth network {self.name} has results that are not finite: copy its folder again")
        return estimate

    def input_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Height and width [pixels] at which the network reads a picture of ``size``: whole patches."""
        patch = self.config.backbone.patch_size
        shorter = max(1, round(self.shorter_side / patch))
        aspect = min(max(size) / min(size), _MOST_ASPECT)
        longer = max(shorter, round(self.shorter_side * aspect / patch))
        return (shorter * patch, longer * patch) if size[0] <= size[1] else (longer * patch, shorter * patch)


def load_depth_network(
    source: str | Path, *, shorter_side: int = 518, compute: Compute = "float32"
) -> FrozenDepthNetwork | DashcamDepth:
    """The depth network in a folder: Depth Anything, version 1 or 2, relative or metric, or that of scjax.

    Args:
      source: as for ``load_image_encoder``, such as "depth-anything/Depth-Anything-V2-Small-hf".
      shorter_side: of the pictures that the network gets [pixels].
      compute: precision of products with the weights.

    Raises:
      ValueError: names the file, array or field at fault and the cure.
    """
    folder = find_network_folder(source, "depth network").resolve()
    loaded = _load(folder, compute)
    if loaded.network is dashcam_weights.NETWORK:
        return DashcamDepth(loaded)
    return FrozenDepthNetwork(loaded, shorter_side)


@functools.lru_cache(maxsize=2)
def _load(folder: Path, compute: Compute) -> LoadedNetwork:
    return load_network(folder, DEPTH_NETWORKS, compute)


def from_inverse(inverse: Float[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Depth in units of the smallest one: 1 at the largest inverse depth, ``FAR_RATIO`` at the smallest possible."""
    inverse = np.maximum(np.nan_to_num(inverse.astype(np.float64)), 0)
    largest = inverse.max(initial=0.0)
    if largest <= 0:
        return np.full(inverse.shape, FAR_RATIO, np.float32)
    return (1 / np.maximum(inverse / largest, 1 / FAR_RATIO)).astype(np.float32)


def depth_tokens(provider: DepthProvider, photos: Sequence[Photo], preprocessing: Preprocessing) -> list[GridTokens]:
    """One number a cell: its mean depth, 0 at the picture's smallest depth and 1 at its largest.

    Cells whose depth is not known, and those that show no picture, are 0 and masked.

    Raises:
      ValueError: a provider's depth is no map of numbers; names the photo.
    """
    results = []
    for photo in photos:
        depth = provider(photo)
        if depth is None:
            depth = np.full((1, 1), np.nan, np.float32)
        depth = check_depth(depth, f"depth of {photo.name or 'the image'}")
        results.append(_pooled(depth, photo.size, preprocessing))
    return results


def check_depth(depth: object, name: str) -> Float32[np.ndarray, "height width"]:
    """``depth`` as float32.

    Raises:
      ValueError: it is no array [height, width] of numbers, empty, or holds negative depths.
    """
    array = np.asarray(depth)
    if array.ndim != 2 or not array.size or array.dtype.kind not in "iuf":
        raise ValueError(f"{name} must be numbers [height, width], not {array.dtype} of shape {array.shape}")
    array = array.astype(np.float32)
    if (array < 0).any():
        raise ValueError(f"{name} is negative in {int((array < 0).sum())} places: give depth, NaN where it is unknown")
    return array


def _pooled(
    depth: Float32[np.ndarray, "height width"], size: tuple[int, int], preprocessing: Preprocessing
) -> GridTokens:
    grid = (preprocessing.rows, preprocessing.columns)
    is_known = ~np.isnan(depth)
    finite = depth[np.isfinite(depth)].astype(np.float64)
    if not finite.size:
        return GridTokens(np.zeros((grid[0] * grid[1], 1), np.float32), np.zeros(grid[0] * grid[1], bool), grid)
    low, high = finite.min(), finite.max()
    scaled = (np.minimum(np.where(is_known, depth, low), high) - low) / (high - low if high > low else 1.0)
    by_row, by_column = cell_matrices(preprocessing, size, depth.shape)
    shares = by_row @ is_known @ by_column.T
    sums = by_row @ np.where(is_known, scaled, 0.0) @ by_column.T
    mask = real_cells(shares)
    means = np.where(mask, sums / np.where(mask, shares, 1.0), 0.0)
    return GridTokens(means.reshape(-1, 1).astype(np.float32), mask.reshape(-1), grid)
