"""The camera of a picture as tokens: where each cell of the picture looks, and from where."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool

from scjax.camera.camera import Camera
from scjax.camera.projection import pixel_rays
from scjax.camera.rig import Rig
from scjax.encoders.preprocessing import Preprocessing
from scjax.encoders.vision import GridTokens

RAY_NUMBERS = 6
"""Numbers of a token: unit direction x, y, z of the cell's middle, position x, y, z of the camera [m]."""

_MOST_ASIDE = 60.0  # degrees between the camera's axis and straight ahead


def picture_camera(camera: object, size: tuple[int, int]) -> Camera:
    """The camera of a picture of ``size`` (height, width) ahead, in the ego's frame.

    Args:
      camera: a camera in the frame of the ego, x ahead, from the middle of its box on the ground; or a rig of one
        camera, whose frame has its ``origin`` there.

    Raises:
      ValueError: it is no camera, its pictures have other proportions, or it looks aside.
    """
    if isinstance(camera, Rig):
        origin, camera = camera.origin, camera.camera()
        camera = dataclasses.replace(camera, translation=origin + camera.translation)
    if not isinstance(camera, Camera):
        raise ValueError(f"it must be a scjax.camera.Camera or a Rig of one, not of type {type(camera).__name__}")
    height, width = size
    camera.check_proportions(width, height)
    axis = camera.rotation[:, 2]
    aside = np.degrees(np.arccos(np.clip(axis[0] / max(float(np.linalg.norm(axis)), 1e-9), -1, 1)))
    if aside > _MOST_ASIDE:
        raise ValueError(f"it looks {aside:.0f} degrees away from straight ahead: give a camera that looks ahead")
    return camera


def camera_tokens(camera: Camera, mask: Bool[np.ndarray, " cells"], preprocessing: Preprocessing) -> GridTokens:
    """A ray for every cell of a picture of the camera, whatever its size.

    Args:
      mask: cells that show the picture. The tokens of others, and of those where the lens shows nothing, are zero and
        masked.
    """
    top, left, height, width = preprocessing.content((camera.height, camera.width))
    rows, columns = np.indices((preprocessing.rows, preprocessing.columns)).reshape(2, -1)
    y = ((rows + 0.5 - top) / height) * camera.height - 0.5
    x = ((columns + 0.5 - left) / width) * camera.width - 0.5
    rays = pixel_rays(camera, np.stack([x, y], -1))
    mask = mask & np.isfinite(rays).all(-1)
    rays = np.column_stack([np.where(mask[:, None], rays, 0.0), np.ones(len(rays))]) @ camera.rotation.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    tokens = np.concatenate([rays, np.broadcast_to(camera.translation, rays.shape)], -1)
    tokens = np.where(mask[:, None], tokens, 0).astype(np.float32)
    return GridTokens(tokens, mask, (preprocessing.rows, preprocessing.columns))
