"""Pictures of any size and kind as RGB: read from files, or given as arrays."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".gif", ".ppm", ".pgm", ".jp2")
MAX_PIXELS = 150_000_000
"""Of a picture: 8k video has 33 million; more would take half a gigabyte."""

BACKGROUND = (124, 116, 104)
"""Color behind transparent pixels and around letterboxed pictures: the mean of the encoders' training data."""

_FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF", "GIF", "PPM", "JPEG2000")  # none of them runs other programs
_CURE = "give a PNG or JPEG file"
_ORIENTATION = 0x0112  # EXIF tag
_WIDE_MODES = ("I;16", "I;16L", "I;16B", "I;16N", "I")
_BYTE, _WORD = 255, 65535


@dataclasses.dataclass(frozen=True)
class Photo:
    """A picture, decoded when its pixels are first needed.

    Attributes:
      name: of its file, for messages; "" for arrays.
      content: SHA-256 of the file's bytes, or of the array.
      decode: makes the pixels.
    """

    name: str
    content: str
    decode: Callable[[], np.ndarray]

    @functools.cached_property
    def pixels(self) -> UInt8[np.ndarray, "height width 3"]:
        """RGB.

        Raises:
          ValueError: the file is cut, too large or no picture; names it and the cure.
        """
        return self.decode()

    @property
    def size(self) -> tuple[int, int]:
        """Height and width [pixels]."""
        return self.pixels.shape[0], self.pixels.shape[1]


def read_photo(path: str | Path) -> Photo:
    """A picture from a file, upright as its EXIF data say; of several pictures in a file, the first.

    16-bit grays become 8-bit ones. Transparent pixels get the color ``BACKGROUND``.

    Raises:
      ValueError: the file is missing, cut, too large or no picture; names it and the cure.
    """
    photo = open_photo(path)
    _ = photo.pixels
    return photo


def open_photo(path: str | Path) -> Photo:
    """As ``read_photo``, but the bytes are decoded later, if ever.

    Raises:
      ValueError: the file cannot be read; names it and the cure.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error}): {_CURE}") from error
    return Photo(str(path), hashlib.sha256(data).hexdigest(), lambda: _decode(data, path))


def photo_from_array(pixels: Any) -> Photo:
    """A picture from an array: RGB [height, width, 3], RGBA [height, width, 4] or gray [height, width], uint8.

    Raises:
      ValueError: it is of another shape or type.
    """
    array = np.asarray(pixels)
    is_picture = array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (3, 4))
    if array.dtype != np.uint8 or not is_picture or not array.size:
        raise ValueError(
            f"an image must be uint8 [height, width, 3], [height, width, 4] or [height, width], not {array.dtype} of "
            f"shape {array.shape}: convert it, with colors 0..255"
        )
    digest = hashlib.sha256(f"{array.shape}".encode() + np.ascontiguousarray(array).tobytes()).hexdigest()
    if array.ndim == 2:
        array = np.repeat(array[..., None], 3, 2)
    return Photo("", digest, lambda: _opaque(np.ascontiguousarray(array)))


def as_photo(image: Any) -> Photo:
    """A photo of a path, an array or a photo.

    Raises:
      ValueError: as ``read_photo`` and ``photo_from_array``.
    """
    if isinstance(image, Photo):
        return image
    return read_photo(image) if isinstance(image, str | Path) else photo_from_array(image)


def _decode(data: bytes, path: Path) -> np.ndarray:
    from PIL import Image, UnidentifiedImageError

    if not data:
        raise ValueError(f"{path}: is empty: {_CURE}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of odd metadata, and of sizes that are checked here
        try:
            with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
                if image.width * image.height > MAX_PIXELS:
                    raise ValueError(f"it has {image.width} x {image.height} pixels, more than {MAX_PIXELS}")
                turn = _turn(image)
                image.load()
                pixels = _rgb(image)
        except UnidentifiedImageError as error:
            raise ValueError(f"{path}: is no picture in a known format: {_CURE}") from error
        except (KeyboardInterrupt, SystemExit):
            raise
        except MemoryError as error:
            raise ValueError(f"{path}: needs more memory than there is: make the picture smaller") from error
        except Exception as error:  # decoders raise many kinds for damaged bytes
            raise ValueError(f"{path}: cannot be decoded ({error}): copy it again, or {_CURE}") from error
    if not pixels.size:
        raise ValueError(f"{path}: has no pixels: {_CURE}")
    return np.ascontiguousarray(turn(pixels))


def _rgb(image: Any) -> np.ndarray:
    """RGB of a picture in any mode of Pillow."""
    if image.mode in _WIDE_MODES:
        return _from_wide(np.asarray(image))
    if image.mode == "F":
        raise ValueError("its pixels are floating-point numbers, whose range is not known")
    if image.mode in ("RGBA", "LA", "PA", "RGBa", "La") or "transparency" in image.info:
        return _over_background(image.convert("RGBA"))
    return np.asarray(image.convert("RGB"))


def _from_wide(values: np.ndarray) -> np.ndarray:
    """8-bit RGB of 16-bit grays."""
    if values.min() < 0 or values.max() > _WORD:
        raise ValueError("its pixels are 32-bit numbers, whose range is not known")
    gray = np.round(values.astype(np.float32) * np.float32(_BYTE / _WORD)).astype(np.uint8)
    return np.repeat(gray[..., None], 3, 2)


def _opaque(pixels: np.ndarray) -> np.ndarray:
    """RGB of RGB or RGBA."""
    if pixels.shape[2] == 3:
        return pixels
    from PIL import Image

    return _over_background(Image.fromarray(pixels))


def _over_background(image: Any) -> np.ndarray:
    """RGB of a picture of mode RGBA."""
    from PIL import Image

    background = Image.new("RGBA", image.size, (*BACKGROUND, _BYTE))
    return np.asarray(Image.alpha_composite(background, image).convert("RGB"))


def _turn(image: Any) -> Any:
    """The function that turns pixels upright; damaged EXIF data turn nothing."""
    try:
        orientation = image.getexif().get(_ORIENTATION, 1)
    except Exception:
        orientation = 1
    turns = {
        2: lambda x: x[:, ::-1],
        3: lambda x: x[::-1, ::-1],
        4: lambda x: x[::-1],
        5: lambda x: x.swapaxes(0, 1),
        6: lambda x: np.rot90(x, -1),
        7: lambda x: x[::-1, ::-1].swapaxes(0, 1),
        8: lambda x: np.rot90(x),
    }
    return turns.get(orientation, lambda x: x) if isinstance(orientation, int) else lambda x: x
