"""Depth from files beside the pictures: arrays of NumPy, or 16-bit PNG pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float32

from scjax.camera.photo import Photo
from scjax.encoders.depth import MAX_DEPTH, check_depth, from_inverse
from scjax.nn.safetensors import sha256_of
from scjax.scene.arguments import finite_number

PNG_UNIT = 1 / 256
"""Meters that a number of a PNG file stands for, as in KITTI."""

DEPTH_SUFFIXES = (".npy", ".npz", ".png")
_ARRAY_NAMES = ("depth", "depths")  # in .npz files; the second is the release's
_CURE = "write depth as an array [height, width] in an .npy file"


class FileDepth:
    """Depth of a photo from the file of its name in a folder: NAME.npy, NAME.npz (array "depth") or NAME.png.

    PNG files hold whole numbers: ``unit`` times the number is the depth, and 0 means unknown, as in KITTI.

    Args:
      folder: of the files.
      root: of the photos: their paths in it are those of the depth files in ``folder``; None: names alone count.
      is_inverse: whether the files hold inverse depth, as relative depth networks give it.
      unit: meters a number of a PNG file stands for.

    Raises:
      ValueError: there is no such folder.
    """

    def __init__(
        self, folder: str | Path, *, root: str | Path | None = None, is_inverse: bool = False, unit: float = PNG_UNIT
    ):
        self.folder, self.root, self.is_inverse = Path(folder), None if root is None else Path(root), is_inverse
        self.unit = finite_number(unit, "unit", 1e-9, 1e9)
        if not self.folder.is_dir():
            raise ValueError(f"{folder}: no such folder of depth files")

    def key_of(self, photo: Photo) -> str:
        """Options and the hash of the photo's depth file."""
        path = self.path_of(photo)
        if path is None:
            return "none"
        return f"file-{sha256_of(path)[:24]}-{self.unit:g}{'-inverse' if self.is_inverse else ''}"

    def path_of(self, photo: Photo) -> Path | None:
        """The depth file of a photo, or None."""
        name = Path(photo.name)
        if self.root is not None and name.is_relative_to(self.root):
            name = name.relative_to(self.root)
        else:
            name = Path(name.name)
        paths = [self.folder / name.with_suffix(suffix) for suffix in DEPTH_SUFFIXES] if photo.name else []
        return next((path for path in paths if path.is_file()), None)

    def __call__(self, photo: Photo) -> Float32[np.ndarray, "height width"] | None:
        """Depth, NaN where it is unknown; None without a file.

        Raises:
          ValueError: the file is damaged or holds something else; names it and the cure.
        """
        path = self.path_of(photo)
        if path is None:
            return None
        depth = read_depth(path, self.unit)
        if self.is_inverse:
            return np.where(np.isnan(depth), np.float32(np.nan), from_inverse(depth))
        return np.minimum(depth, np.float32(MAX_DEPTH))


def read_depth(path: str | Path, unit: float = PNG_UNIT) -> Float32[np.ndarray, "height width"]:
    """Depth in a file .npy, .npz or .png as of ``FileDepth``, NaN where it is unknown.

    Raises:
      ValueError: the file is damaged or holds something else; names it and the cure.
    """
    path = Path(path)
    try:
        values = _read_png(path) * np.float32(unit) if path.suffix == ".png" else _read_array(path)
    except (KeyboardInterrupt, SystemExit):
        raise
    except Exception as error:  # NumPy and Pillow raise many kinds for damaged bytes
        raise ValueError(f"{path}: cannot be read as depth ({error}): {_CURE}") from error
    if values.ndim == 3 and values.shape[0] == 1:  # [1, height, width], as the release stores it
        values = values[0]
    return check_depth(values, str(path))


def _read_array(path: Path) -> np.ndarray:
    content = np.load(path, allow_pickle=False)
    if isinstance(content, np.ndarray):
        return content
    with content:
        for name in _ARRAY_NAMES:
            if name in content:
                return content[name]
        raise ValueError(f"it has no array named {' or '.join(_ARRAY_NAMES)}")


def _read_png(path: Path) -> Float32[np.ndarray, "height width"]:
    """Numbers of a gray PNG; NaN at 0."""
    from PIL import Image

    with Image.open(path, formats=("PNG",)) as image:
        values = np.asarray(image)
    if values.ndim != 2 or values.dtype == bool:
        raise ValueError("it is a picture in color, not of depths")
    return np.where(values > 0, values.astype(np.float32), np.float32(np.nan))
