"""The camera of a picture as tokens: where each cell of the picture looks, and from where."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from scjax.encoders.preprocessing import Preprocessing
from scjax.encoders.vision import GridTokens

RAY_NUMBERS = 6
"""Numbers of a token: unit direction x, y, z of the cell's middle, position x, y, z of the camera [m]."""

_ASPECT_TOLERANCE = 0.02
_MOST_ASIDE = 60.0  # degrees between the camera's axis and straight ahead


@runtime_checkable
class PictureCamera(Protocol):
    """A pinhole camera; axes as in OpenCV: x right, y down, z ahead. Whole pixel coordinates are centers of pixels.

    Attributes:
      width, height: of its pictures [pixels].
      intrinsic: [3, 3] focal lengths and principal point [pixels].
      rotation: [3, 3] its columns are the camera's axes in the ego's frame: x ahead, y left, z up.
      translation: [3] position in the ego's frame [m].
      distortion: of the lens; zeros for none.
    """

    width: int
    height: int
    intrinsic: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    distortion: np.ndarray


def check_camera(camera: object, size: tuple[int, int]) -> PictureCamera:
    """A camera that can have taken a picture of ``size`` (height, width) ahead.

    Raises:
      ValueError: it is no camera, its pictures have other proportions, its lens bends lines, or it looks aside.
    """
    if not isinstance(camera, PictureCamera):
        raise ValueError(
            f"it must have width, height, intrinsic, rotation, translation and distortion, not be a "
            f"{type(camera).__name__}"
        )
    shapes = {"intrinsic": (3, 3), "rotation": (3, 3), "translation": (3,)}
    for name, shape in shapes.items():
        value = np.asarray(getattr(camera, name))
        if value.shape != shape or value.dtype.kind not in "iuf" or not np.isfinite(value).all():
            raise ValueError(f"{name} must be finite numbers of shape {shape}")
    intrinsic = np.asarray(camera.intrinsic)
    if not (camera.width > 0 and camera.height > 0 and min(intrinsic[0, 0], intrinsic[1, 1]) > 0):
        raise ValueError("width, height and focal lengths must be positive")
    if np.any(camera.distortion):
        raise ValueError("its lens has a distortion: undistort the picture, and give the camera without it")
    aspect, expected = size[1] / size[0], camera.width / camera.height
    if abs(aspect / expected - 1) > _ASPECT_TOLERANCE:
        raise ValueError(
            f"its pictures have {camera.width} x {camera.height} pixels, but the image {size[1]} x {size[0]}: give the "
            "camera of the whole picture"
        )
    axis = np.asarray(camera.rotation)[:, 2]
    aside = np.degrees(np.arccos(np.clip(axis[0] / max(float(np.linalg.norm(axis)), 1e-9), -1, 1)))
    if aside > _MOST_ASIDE:
        raise ValueError(f"it looks {aside:.0f} degrees away from straight ahead: give a camera that looks ahead")
    return camera


def camera_tokens(
    camera: PictureCamera, size: tuple[int, int], mask: np.ndarray, preprocessing: Preprocessing
) -> GridTokens:
    """A ray for every cell of a picture of ``size`` (height, width), which may be larger or smaller than the camera's.

    Args:
      mask: [cells] cells that show the picture; the tokens of others are zero.
    """
    top, left, height, width = preprocessing.content(size)
    rows, columns = np.indices((preprocessing.rows, preprocessing.columns)).reshape(2, -1)
    y = ((rows + 0.5 - top) / height) * camera.height - 0.5
    x = ((columns + 0.5 - left) / width) * camera.width - 0.5
    rays: Float[np.ndarray, "cells 3"] = np.stack([x, y, np.ones(len(x))], -1)
    rays = rays @ np.linalg.inv(camera.intrinsic).T @ np.asarray(camera.rotation).T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    tokens = np.concatenate([rays, np.broadcast_to(camera.translation, rays.shape)], -1)
    tokens = np.where(mask[:, None], tokens, 0).astype(np.float32)
    return GridTokens(tokens, mask, (preprocessing.rows, preprocessing.columns))
