"""Photographs as arrays, whatever their files hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageOps

MAX_MEGAPIXELS = 200


def read_photograph(
    photograph: str | Path | UInt8[np.ndarray, "height width channels"],
) -> UInt8[np.ndarray, "height width 3"]:
    """A picture as RGB, turned as its camera was held; transparent parts are black.

    Args:
      photograph: a file, or a picture of 1, 3 or 4 channels.

    Raises:
      ValueError: naming the file: it is not there, no picture, cut short or too large; or an array of another kind.
    """
    if isinstance(photograph, np.ndarray):
        if photograph.ndim != 3 or photograph.shape[2] not in (1, 3, 4) or not photograph.size:
            raise ValueError(
                f"a picture is of shape {photograph.shape}: give [height, width, 1, 3 or 4 channels] uint8"
            )
        channels = photograph.shape[2]
        if channels == 3:
            return photograph
        return _rgb(Image.fromarray(photograph[..., 0] if channels == 1 else photograph))
    path = Path(photograph)
    try:
        with Image.open(path) as image:
            if image.width * image.height > MAX_MEGAPIXELS * 1_000_000:
                raise ValueError(f"{path}: {image.width} x {image.height} pixels are too many: make it smaller")
            return _rgb(ImageOps.exif_transpose(image))
    except FileNotFoundError as error:
        raise ValueError(f"{path}: there is no such picture: give the name of a JPEG or PNG file") from error
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(f"{path}: it cannot be read as a picture ({error}): give a whole JPEG or PNG file") from error


def _rgb(image: Image.Image) -> np.ndarray:
    if image.mode.startswith(("I", "F")):  # 16 or 32 bits of gray
        gray = np.asarray(image, np.float64)
        scale = 255 / 65535 if gray.max(initial=0) > 255 else 1.0
        image = Image.fromarray((gray * scale).clip(0, 255).astype(np.uint8))
    if image.mode in ("LA", "PA", "RGBA", "La", "RGBa") or "transparency" in image.info:
        layer = image.convert("RGBA")
        black = Image.new("RGBA", layer.size, (0, 0, 0, 255))
        image = Image.alpha_composite(black, layer)
    return np.asarray(image.convert("RGB"))
