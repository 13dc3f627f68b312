"""Resizing by one small matrix per axis, with pixel centers at half numbers unless corners are aligned.

``bicubic_matrix`` has a = -0.75, as position tables of published networks expect; ``jax.image.resize`` has -0.5.
"""

from __future__ import annotations

import functools
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, Shaped

_POSITION_CUBIC, _ANTIALIAS_CUBIC = -0.75, -0.5  # Keys' parameter: of plain interpolation, and where it is antialiased
_SUPPORT = {"linear": 1.0, "cubic": 2.0}  # source pixels on either side

Kernel = Literal["linear", "cubic"]


@functools.lru_cache(maxsize=64)
def bicubic_matrix(size: int, target: int) -> Float32[np.ndarray, "target size"]:
    """Weights of four neighbors, without antialiasing; pixels beyond the border repeat the last one."""
    position = (np.arange(target) + 0.5) * (size / target) - 0.5
    first = np.floor(position).astype(int)
    weights = np.zeros((target, size))
    for offset in range(-1, 3):
        neighbor = first + offset
        row_weights = _cubic(np.abs(position - neighbor), _POSITION_CUBIC)
        np.add.at(weights, (np.arange(target), np.clip(neighbor, 0, size - 1)), row_weights)
    return weights.astype(np.float32)


@functools.lru_cache(maxsize=64)
def bilinear_matrix(size: int, target: int, *, align_corners: bool) -> Float32[np.ndarray, "target size"]:
    """Weights of two neighbors, without antialiasing.

    Args:
      align_corners: whether the first and last pixels keep their places, instead of the borders of the picture.
    """
    if align_corners:
        position = np.arange(target) * ((size - 1) / max(target - 1, 1))
    else:
        position = np.clip((np.arange(target) + 0.5) * (size / target) - 0.5, 0, size - 1)
    low = np.clip(np.floor(position).astype(int), 0, size - 1)
    share = position - low
    weights = np.zeros((target, size))
    np.add.at(weights, (np.arange(target), low), 1 - share)
    np.add.at(weights, (np.arange(target), np.minimum(low + 1, size - 1)), share)
    return weights.astype(np.float32)


@functools.lru_cache(maxsize=64)
def antialias_matrix(size: int, target: int, kernel: Kernel) -> Float32[np.ndarray, "target size"]:
    """Weights of a kernel that is as much wider as the picture shrinks; every row sums to one."""
    weights = np.zeros((target, size), np.float32)
    for row, (start, values) in enumerate(_antialias_taps(size, target, kernel)):
        weights[row, start : start + len(values)] = values
    return weights


def resize_antialiased(
    image: Shaped[np.ndarray, "height width channels"], rows: int, columns: int, kernel: Kernel = "linear"
) -> Float32[np.ndarray, "rows columns channels"]:
    """An image of another size, in float32; integers keep their range.

    The time is that of reading the image a few times, since each row of the result needs few rows of the image.
    """
    halfway = _resize_rows(image, rows, kernel)
    return _resize_rows(halfway.swapaxes(0, 1), columns, kernel).swapaxes(0, 1)


def _resize_rows(image: np.ndarray, rows: int, kernel: Kernel) -> np.ndarray:
    result = np.empty((rows, *image.shape[1:]), np.float32)
    for row, (start, weights) in enumerate(_antialias_taps(len(image), rows, kernel)):
        part = image[start : start + len(weights)].astype(np.float32)
        result[row] = np.tensordot(weights, part, 1)
    return result


@functools.lru_cache(maxsize=64)
def _antialias_taps(size: int, target: int, kernel: Kernel) -> list[tuple[int, Float[np.ndarray, " taps"]]]:
    """First source pixel and weights of every target pixel."""
    scale = size / target
    width = max(scale, 1.0)
    support = _SUPPORT[kernel] * width
    taps = []
    for row in range(target):
        center = scale * (row + 0.5)
        start, stop = max(int(center - support + 0.5), 0), min(int(center + support + 0.5), size)
        distance = np.abs((np.arange(start, stop) + 0.5 - center) / width)
        weights = np.maximum(1 - distance, 0) if kernel == "linear" else _cubic(distance, _ANTIALIAS_CUBIC)
        taps.append((start, (weights / weights.sum()).astype(np.float32)))
    return taps


def _cubic(distance: Float[np.ndarray, " n"], a: float) -> Float[np.ndarray, " n"]:
    """Cubic convolution (Keys 1981) of distances >= 0."""
    near = ((a + 2) * distance - (a + 3)) * distance**2 + 1
    far = ((a * distance - 5 * a) * distance + 8 * a) * distance - 4 * a
    return np.where(distance <= 1, near, np.where(distance < 2, far, 0.0))
