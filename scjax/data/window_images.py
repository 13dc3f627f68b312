"""What a camera sees in the windows of training scenes: ray-cast, or features of pictures that were made before."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32

from scjax.camera.raycast import CLASSES, GRID, render
from scjax.data.image_features import ImageStore
from scjax.scene import Scene


def picture_name(split: str, row: int) -> str:
    """Name of the picture of a record, without ending."""
    return f"{split}-{row:06d}"


class CameraTokens(NamedTuple):
    """Features and depth of the cells of a picture; no depth where a network reads none."""

    image: Float32[np.ndarray, "channels rows columns"]
    depth: Float32[np.ndarray, "rows columns"]
    mask: Bool[np.ndarray, " cells_of_both"]


@runtime_checkable
class WindowImages(Protocol):
    """Pictures of windows ahead of the ego.

    Attributes:
      channels, grid: of the features.
      encoder: whose features they are; "" for none.
      any_pose: whether there are pictures of windows whose pose was moved.
    """

    @property
    def channels(self) -> int: ...

    @property
    def grid(self) -> tuple[int, int]: ...

    @property
    def encoder(self) -> str: ...

    @property
    def any_pose(self) -> bool: ...

    def __call__(self, scene: Scene, row: int) -> CameraTokens:
        """What is seen in the forward window ``scene`` of record ``row``."""
        ...

    def of_split(self, split: str) -> WindowImages:
        """The pictures of another split."""
        ...


class RaycastImages:
    """Semantic classes and depth, ray-cast from the scene itself (``camera.raycast``)."""

    channels, grid, encoder, any_pose = len(CLASSES), GRID, "", True

    def __call__(self, scene: Scene, row: int) -> CameraTokens:
        """As of ``WindowImages``."""
        image, depth = render(scene)
        return CameraTokens(image, depth, np.ones(2 * depth.size, bool))

    def of_split(self, split: str) -> RaycastImages:
        """All splits are alike."""
        return self


class StoredImages:
    """Features that ``scjax data embed-images`` kept of pictures named SPLIT-ROW, one for each record.

    Args:
      folder: the features; split: of the records.

    Raises:
      ValueError: there are none, or none of this split.
    """

    any_pose = False

    def __init__(self, folder: str | Path, split: str):
        self._folder, self._split, self._store = folder, split, ImageStore(folder)
        names = {Path(file).stem: file for file in self._store.files}
        self._files = {name: file for name, file in names.items() if name.startswith(f"{split}-")}
        if not self._files:
            raise ValueError(f"{folder} has features of no picture of the split {split}: see scjax data dashcam --help")

    @property
    def channels(self) -> int:
        """Numbers of a token."""
        return self._store.width

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of cells."""
        return self._store.grid

    @property
    def encoder(self) -> str:
        """Name of the encoder."""
        return self._store.encoder

    def of_split(self, split: str) -> StoredImages:
        """The pictures of another split."""
        return StoredImages(self._folder, split)

    def __call__(self, scene: Scene, row: int) -> CameraTokens:
        """As of ``WindowImages``.

        Raises:
          ValueError: the record has no picture, or its features are damaged.
        """
        del scene
        name = picture_name(self._split, row)
        if name not in self._files:
            raise ValueError(f"{self._folder} has no features of {name}: run scjax data dashcam and embed-images again")
        image, depth = self._store.image(self._files[name]), self._store.depth(self._files[name])
        rows, columns = image.grid
        empty = np.zeros((rows, columns), np.float32)
        return CameraTokens(
            np.ascontiguousarray(image.tokens.T.reshape(-1, rows, columns)),
            empty if depth is None else depth.tokens.reshape(rows, columns),
            np.concatenate([image.mask, np.zeros_like(image.mask) if depth is None else depth.mask]),
        )
