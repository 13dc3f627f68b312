"""Pictures -> features of their patches: a frozen network with weights that users bring."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from scjax.camera.photo import Photo, as_photo
from scjax.encoders import dashcam_weights, vit_weights
from scjax.encoders.base import PublishedNetwork
from scjax.encoders.hub_folder import find_network_folder
from scjax.encoders.image_network import LoadedNetwork, compiled_network, in_groups, load_network, run_padded
from scjax.encoders.preprocessing import SQUASH, Preprocessing, prepare_image
from scjax.nn.cpu.precision import Compute, operands

IMAGE_NETWORKS: dict[str, PublishedNetwork] = {
    **dict.fromkeys(("dinov2", "dinov2_with_registers", "dinov3_vit"), vit_weights.NETWORK),
    dashcam_weights.MODEL_TYPE: dashcam_weights.NETWORK,
}
"""``model_type`` of a ``config.json`` -> the network that reads such folders."""


class GridTokens(NamedTuple):
    """Tokens of the cells of a grid, row-major.

    Attributes:
      tokens: of every cell.
      mask: cells that show the picture; the tokens of others are zero.
      grid: rows and columns.
    """

    tokens: Float[np.ndarray, "cells width"]
    mask: Bool[np.ndarray, " cells"]
    grid: tuple[int, int]


@runtime_checkable
class ImageEncoder(Protocol):
    """Turns pictures into tokens.

    Attributes:
      name: a model fits the features of one name only.
      key: differs between encoders whose features differ at all, be it by rounding.
      width: features of a token.
    """

    @property
    def name(self) -> str: ...

    @property
    def key(self) -> str: ...

    @property
    def width(self) -> int: ...

    def __call__(self, images: Sequence[Photo], preprocessing: Preprocessing) -> list[GridTokens]:
        """Tokens of every picture."""
        ...


class FrozenImageEncoder:
    """A network with its weights. ``name`` changes with the weights: a model fits the features of one name only."""

    def __init__(self, loaded: LoadedNetwork):
        self.config, self.params, self.name = loaded.config, loaded.params, loaded.name
        self._program = compiled_network(loaded.network, loaded.config)

    @property
    def width(self) -> int:
        """Features of a token."""
        return self.config.width

    @property
    def key(self) -> str:
        """The name and the precision."""
        return f"{self.name}-{operands(self.config.compute)}"

    def __call__(
        self, images: Sequence[Photo | str | Path | np.ndarray], preprocessing: Preprocessing = SQUASH
    ) -> list[GridTokens]:
        """Tokens of every image, the same as if it were alone but for float32 rounding.

        Args:
          images: photos, files, or arrays (``photo_from_array``).

        Raises:
          ValueError: an image that cannot be read, or features that are not finite, as of damaged weights.
        """
        results: list[GridTokens] = []
        for group in in_groups(images):
            prepared = [prepare_image(as_photo(image), preprocessing, self.config.patch_size) for image in group]
            features = run_padded(self._program, self.params, [one.pixels for one in prepared])
            if not np.isfinite(features).all():
                raise ValueError(
                    f"the image encoder {self.name} has features that are not finite: copy its folder again"
                )
            for one, tokens in zip(prepared, features, strict=True):
                mask = one.mask.reshape(-1)
                grid = (preprocessing.rows, preprocessing.columns)
                results.append(GridTokens(np.where(mask[:, None], tokens, 0).astype(np.float32), mask, grid))
        return results


def load_image_encoder(source: str | Path, *, compute: Compute = "float32") -> FrozenImageEncoder:
    """The encoder in a folder: DINOv2, DINOv2 with registers or DINOv3, of any size without gated layers.

    Args:
      source: a folder with config.json and model.safetensors (or its shards and their index), or the name of a
        network in the Hugging Face cache, such as "facebook/dinov2-small".
      compute: precision of products with the weights; "bfloat16" changes features by about a percent.

    Raises:
      ValueError: names the file, array or field at fault and the cure.
    """
    return _load(find_network_folder(source, "image encoder").resolve(), compute)


@functools.lru_cache(maxsize=2)
def _load(folder: Path, compute: Compute) -> FrozenImageEncoder:
    return FrozenImageEncoder(load_network(folder, IMAGE_NETWORKS, compute))
