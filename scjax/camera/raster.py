"""Lines and convex areas in pictures: antialiased and at fractions of a pixel, by OpenCV, imported here only."""

from __future__ import annotations

from types import ModuleType

import numpy as np
from jaxtyping import Float64, Int, Int32, UInt8

_SHIFT = 4  # bits of the fraction of a pixel
_UNIT = 1 << _SHIFT


def require_opencv() -> ModuleType:
    """The module cv2.

    Raises:
      ValueError: it is not installed.
    """
    try:
        import cv2
    except ImportError as error:
        raise ValueError(
            "pictures of cameras need OpenCV, which is not installed: pip install 'scjax[camera]'"
        ) from error
    return cv2


def draw_segments(
    image: UInt8[np.ndarray, "height width channels"],
    ends: Float64[np.ndarray, "n 2 2"],
    colors: UInt8[np.ndarray, "n channels"],
    widths: Int[np.ndarray, " n"],
) -> None:
    """Draws antialiased lines one after the other.

    Args:
      ends: column and row of both ends [pixels], not far beside the picture.
      colors: of each line.
      widths: of each line [pixels].
    """
    cv2 = require_opencv()
    line, smooth = cv2.line, cv2.LINE_AA
    fixed = np.round(ends * _UNIT).astype(np.int32).tolist()
    for (first, second), color, width in zip(fixed, colors.tolist(), widths.tolist(), strict=True):
        line(image, first, second, color, width, smooth, _SHIFT)


def draw_indices(
    indices: Int32[np.ndarray, "height width"],
    ends: Float64[np.ndarray, "n 2 2"],
    numbers: Int[np.ndarray, " n"],
    widths: Int[np.ndarray, " n"],
) -> None:
    """Writes the number of each line into the pixels that it covers."""
    cv2 = require_opencv()
    fixed = np.round(ends * _UNIT).astype(np.int32).tolist()
    for (first, second), number, width in zip(fixed, numbers.tolist(), widths.tolist(), strict=True):
        cv2.line(indices, first, second, number, width, cv2.LINE_8, _SHIFT)


def fill_index(
    indices: Int32[np.ndarray, "height width"], polygon: Float64[np.ndarray, "corners 2"], number: int
) -> None:
    """Writes a number into the pixels of a convex area."""
    cv2 = require_opencv()
    cv2.fillConvexPoly(indices, np.round(polygon * _UNIT).astype(np.int32), number, cv2.LINE_8, _SHIFT)


def fill_smooth(
    image: UInt8[np.ndarray, "height width"], polygon: Float64[np.ndarray, "corners 2"], value: int
) -> None:
    """Fills a convex area with an antialiased border."""
    cv2 = require_opencv()
    cv2.fillConvexPoly(image, np.round(polygon * _UNIT).astype(np.int32), value, cv2.LINE_AA, _SHIFT)


def convex_hull(points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "corners 2"]:
    """The corners of the smallest convex area around points."""
    hull = require_opencv().convexHull(points.astype(np.float32))
    return hull.reshape(-1, 2).astype(np.float64)


def darken(
    image: UInt8[np.ndarray, "height width channels"], polygon: Float64[np.ndarray, "corners 2"], opacity: float
) -> None:
    """Lays a black area of this opacity over a convex part of a picture."""
    cv2 = require_opencv()
    height, width = image.shape[:2]
    left, top = np.floor(polygon.min(0)).astype(int).clip(0, None).tolist()
    right, bottom = (np.ceil(polygon.max(0)).astype(int) + 1).clip(None, (width, height)).tolist()
    if right <= left or bottom <= top:
        return
    if opacity >= 1.0:
        cv2.fillConvexPoly(image, np.round(polygon * _UNIT).astype(np.int32), (0,) * image.shape[2], cv2.LINE_8, _SHIFT)
        return
    part = image[top:bottom, left:right]
    mask = np.zeros(part.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, np.round((polygon - (left, top)) * _UNIT).astype(np.int32), 255, cv2.LINE_8, _SHIFT)
    cv2.copyTo(cv2.convertScaleAbs(part, alpha=1.0 - opacity), mask, part)
