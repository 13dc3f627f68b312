"""The standard view: what a level dashcam of known lens and height would have seen, from the picture of another camera.

Distances cannot be read from a picture whose lens, height and pitch are not known: five percent more focal length bring
everything five percent nearer. A network that reads standard views alone need not guess them. Lens, focal length and
angles follow exactly. The height follows for the ground: rows are stretched about the horizon, so that each place of
the ground is where the standard camera sees it; what stands on it is stretched, too.
"""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from scjax.camera.camera import Camera, camera_rotation
from scjax.camera.photo import BACKGROUND, Photo
from scjax.camera.presets import preset_rig
from scjax.camera.projection import pixel_rays, project_points

STANDARD_SIZE = (224, 224)
"""Width and height of standard views [pixels]."""

STANDARD_HEIGHT = 1.53
"""Height of the standard camera above the ground [m]."""

STANDARD_AHEAD = 0.2
"""How far the standard camera is ahead of the middle of the ego [m]."""

_HEIGHTS = (0.5, 4.0)  # m; cameras lower or higher count as so high
_MOST_SAMPLES = 8  # of a pixel, to each side


def standard_camera(height: float = STANDARD_HEIGHT) -> Camera:
    """The camera of standard views, in the frame of the ego from the middle of its box on the ground.

    Args:
      height: at which it really is [m]; then rows are stretched about the horizon as if it were at
        ``STANDARD_HEIGHT``.
    """
    dashcam = preset_rig("dashcam").camera()
    squeezed = dashcam.resized(*STANDARD_SIZE)
    intrinsic = squeezed.intrinsic.copy()
    pitch = float(np.arcsin(dashcam.rotation[2, 2]))  # the level camera has the horizon in the same row
    intrinsic[1, 2] += intrinsic[1, 1] * np.tan(pitch)
    intrinsic[1, 1] *= STANDARD_HEIGHT / float(np.clip(height, *_HEIGHTS))
    return Camera(
        name="standard",
        width=STANDARD_SIZE[0],
        height=STANDARD_SIZE[1],
        intrinsic=intrinsic,
        rotation=camera_rotation(),
        translation=np.array([STANDARD_AHEAD, 0.0, height]),
    )


def assumed_camera(size: tuple[int, int]) -> Camera:
    """The camera that counts as the one of a picture of ``size`` (height, width): the dashcam, squeezed to it."""
    rig = preset_rig("dashcam")
    camera = rig.camera().resized(size[1], size[0])
    return dataclasses.replace(camera, translation=rig.origin + camera.translation)


def standard_view(photo: Photo, camera: Camera | None = None) -> Photo:
    """The standard view of a picture; what the picture does not show has the color ``BACKGROUND``.

    Args:
      camera: that took the picture, in the frame of the ego, its height above the ground; by default
        ``assumed_camera``. The picture may have another size than the camera's, of the same proportions.
    """
    if camera is None:
        camera = assumed_camera(photo.size)
    height, width = photo.size
    own = camera if (camera.width, camera.height) == (width, height) else camera.resized(width, height)
    view = standard_camera(float(own.translation[2]))
    numbers = own.intrinsic, own.rotation, own.translation, own.distortion
    parts = [photo.content.encode(), *(np.ascontiguousarray(part).tobytes() for part in numbers)]
    return Photo(photo.name, hashlib.sha256(b"".join(parts)).hexdigest(), lambda: _pixels(photo.pixels, own, view))


def _pixels(pixels: UInt8[np.ndarray, "h w 3"], own: Camera, view: Camera) -> UInt8[np.ndarray, "height width 3"]:
    """Means of samples of the picture in each pixel of the view, so many that no pixel of the picture is left out."""
    focal = np.diag(own.intrinsic)[:2] / np.diag(view.intrinsic)[:2]
    samples = int(np.clip(np.ceil(focal.max()), 1, _MOST_SAMPLES))
    total = np.zeros((view.height, view.width, 3), np.float32)
    for row in range(samples):
        for column in range(samples):
            shift = (np.array([column, row]) + 0.5) / samples - 0.5
            total += _sampled(pixels, _places(own, view, shift))
    return np.clip(np.round(total / samples**2), 0, 255).astype(np.uint8)


def _places(own: Camera, view: Camera, shift: np.ndarray) -> Float64[np.ndarray, "height width 2"]:
    """Column and row in the picture of what pixels of the view see, ``shift`` beside their middles; NaN: nothing."""
    columns, rows = np.meshgrid(np.arange(view.width) + shift[0], np.arange(view.height) + shift[1])
    flat = pixel_rays(view, np.stack([columns, rows], -1))
    rays = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], -1) @ (view.rotation.T @ own.rotation)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    image = project_points(own, rays)
    limits = np.array([own.width, own.height]) - 0.5
    inside = image.visible & (image.pixels > -0.5).all(-1) & (image.pixels < limits).all(-1)
    return np.where(inside[..., None], image.pixels, np.nan)


def _sampled(pixels: np.ndarray, places: np.ndarray) -> Float32[np.ndarray, "height width 3"]:
    """Colors between the pixels around each place, by their distances."""
    shown = np.isfinite(places[..., :1])
    limits = np.array([pixels.shape[1], pixels.shape[0]]) - 1
    places = np.where(shown, places, 0.0).clip(0, limits)
    low = np.minimum(places.astype(np.intp), np.maximum(limits - 1, 0))
    high = np.minimum(low + 1, limits)
    share = (places - low).astype(np.float32)
    (x0, y0), (x1, y1) = np.moveaxis(low, -1, 0), np.moveaxis(high, -1, 0)
    along, down = share[..., :1], share[..., 1:]
    upper = pixels[y0, x0] * (1 - along) + pixels[y0, x1] * along
    lower = pixels[y1, x0] * (1 - along) + pixels[y1, x1] * along
    return np.where(shown, upper * (1 - down) + lower * down, np.array(BACKGROUND, np.float32))
