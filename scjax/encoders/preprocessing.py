"""From a picture to the pixels of an encoder, and the grid of cells that its tokens stand for."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Float32

from scjax.camera.photo import Photo
from scjax.encoders.resize import Kernel, resize_antialiased

PREPROCESSING_VERSION = 1
"""Changes whenever pixels change: features that are kept elsewhere are then made anew."""

MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of the encoders' training data
_MOST_CELLS = 256  # in each axis
_REAL_SHARE = 0.5  # of a cell that must show the picture, over the largest share of all cells


@dataclasses.dataclass(frozen=True)
class Preprocessing:
    """A grid of cells, one a token, and how a picture is laid on it.

    Attributes:
      name: for messages and files.
      rows, columns: of cells.
      keeps_aspect: whether pictures keep their proportions; then empty cells are left above and below, or beside.
    """

    name: str
    rows: int
    columns: int
    keeps_aspect: bool = False

    def __post_init__(self):
        for field in ("rows", "columns"):
            value = getattr(self, field)
            if type(value) is not int or not 1 <= value <= _MOST_CELLS:
                raise ValueError(f"Preprocessing.{field} must be a whole number in 1..{_MOST_CELLS}, not {value!r}")

    @property
    def key(self) -> str:
        """Differs between preprocessings whose pixels differ."""
        shape = "keep" if self.keeps_aspect else "fill"
        return f"{self.rows}x{self.columns}-{shape}-v{PREPROCESSING_VERSION}"

    def content(self, size: tuple[int, int]) -> tuple[float, float, float, float]:
        """Top, left, height and width [cells] of a picture of ``size`` (height, width) [pixels] on the grid."""
        if not self.keeps_aspect:
            return 0.0, 0.0, float(self.rows), float(self.columns)
        scale = min(self.rows / size[0], self.columns / size[1])
        height, width = size[0] * scale, size[1] * scale
        return (self.rows - height) / 2, (self.columns - width) / 2, height, width


SQUASH = Preprocessing("squash", 14, 14)
LETTERBOX = Preprocessing("letterbox", 14, 14, keeps_aspect=True)
WIDE = Preprocessing("wide", 14, 25)
PREPROCESSINGS = {one.name: one for one in (SQUASH, LETTERBOX, WIDE)}
"""By name: the release's square, whatever the picture's shape; a square with borders; 25 : 14, nearly 16 : 9."""


@dataclasses.dataclass(frozen=True)
class PreparedImage:
    """Normalized pixels, and the cells that show the picture; others show the border."""

    pixels: Float32[np.ndarray, "height width 3"]
    mask: Bool[np.ndarray, "rows columns"]


def prepare_image(photo: Photo, preprocessing: Preprocessing, patch_size: int) -> PreparedImage:
    """The picture with one patch a cell: resized (linear, antialiased), then normalized."""
    canvas = np.zeros((preprocessing.rows * patch_size, preprocessing.columns * patch_size, 3), np.float32)
    top, left, height, width = (value * patch_size for value in preprocessing.content(photo.size))
    rows, columns = max(1, round(height)), max(1, round(width))
    row, column = min(round(top), len(canvas) - rows), min(round(left), canvas.shape[1] - columns)
    canvas[row : row + rows, column : column + columns] = normalized_pixels(photo, rows, columns)
    return PreparedImage(canvas, real_cells(cell_shares(preprocessing, photo.size)))


def normalized_pixels(
    photo: Photo, rows: int, columns: int, kernel: Kernel = "linear"
) -> Float32[np.ndarray, "rows columns 3"]:
    """The whole picture at another size, with the mean and deviation that encoders expect."""
    pixels = resize_antialiased(photo.pixels, rows, columns, kernel) / 255
    return (pixels - np.array(MEAN, np.float32)) / np.array(DEVIATION, np.float32)


def cell_shares(preprocessing: Preprocessing, size: tuple[int, int]) -> Float[np.ndarray, "rows columns"]:
    """The part of every cell that a picture of ``size`` covers."""
    by_row, by_column = cell_matrices(preprocessing, size, (1, 1))
    return by_row @ by_column.T


def real_cells(shares: Float[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Cells of which enough is covered; those of a picture as thin as a line are real, too."""
    return (shares > 0) & (shares >= _REAL_SHARE * shares.max())


def cell_matrices(
    preprocessing: Preprocessing, size: tuple[int, int], map_size: tuple[int, int]
) -> tuple[Float[np.ndarray, "rows h"], Float[np.ndarray, "columns w"]]:
    """Shares of cells that the rows, and columns, of a map of the whole picture cover.

    Args:
      size: of the picture; map_size: of the map, which may be another one (height, width).
    """
    top, left, height, width = preprocessing.content(size)
    return (
        _overlaps(preprocessing.rows, top, height, map_size[0]),
        _overlaps(preprocessing.columns, left, width, map_size[1]),
    )


def _overlaps(cells: int, start: float, extent: float, pixels: int) -> np.ndarray:
    """Lengths [cells, pixels] that cell i shares with pixel j."""
    edges = start + extent * np.arange(pixels + 1) / pixels
    low = np.maximum(np.arange(cells)[:, None], edges[None, :-1])
    high = np.minimum(np.arange(1, cells + 1)[:, None], edges[None, 1:])
    return np.maximum(high - low, 0.0)
