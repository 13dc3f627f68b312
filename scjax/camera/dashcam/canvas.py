"""The pinhole picture that is drawn, and how the picture of a camera with a lens is taken from it."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float32, Float64, Int32

from scjax.camera.camera import Camera
from scjax.camera.distortion import NO_DISTORTION
from scjax.camera.projection import pixel_rays
from scjax.camera.raster import require_opencv
from scjax.scene.arguments import whole_number

_LEAST = 1e-4  # 1/m; ground farther away is sky
_WIDEST = 4.0  # x or y at depth 1; what a lens shows farther beside is cut


class Canvas:
    """A larger picture without a lens, from which the pixels of a camera are taken.

    Args:
      camera: whose pictures are made.
      supersampling: pixels drawn for each of the camera's, to both sides.

    Attributes:
      camera: of the canvas, without distortion.
      supersampling: as given.
    """

    def __init__(self, camera: Camera, supersampling: int = 1):
        self.supersampling = whole_number(supersampling, "supersampling", 1, 4)
        self._camera = camera
        columns, rows = np.meshgrid(
            np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64)
        )
        rays = pixel_rays(camera, np.stack([columns, rows], -1).reshape(-1, 2))
        self._rays = np.nan_to_num(rays, nan=_WIDEST).clip(-_WIDEST, _WIDEST)
        straight = dataclasses.replace(camera, distortion=np.array(NO_DISTORTION))
        self._maps = None
        if camera.is_distorted:
            places = self._rays @ camera.intrinsic[:2, :2].T + camera.intrinsic[:2, 2]
            left, top = np.floor(places.min(0)).astype(int) - 1
            right, bottom = np.ceil(places.max(0)).astype(int) + 2
            straight = straight.cropped(int(left), int(top), int(right - left), int(bottom - top))
            places = (places - (left, top) + 0.5) * self.supersampling - 0.5
            self._maps = places.astype(np.float32).reshape(camera.height, camera.width, 2)
        self.camera = straight.resized(self.supersampling * straight.width, self.supersampling * straight.height)

    def of_camera(self, camera: Camera) -> Canvas:
        """The canvas of a camera: this one, if it differs in its mount alone."""
        own = self._camera
        pairs = (own.intrinsic, camera.intrinsic), (own.distortion, camera.distortion)
        if all(np.array_equal(*pair) for pair in pairs) and (own.width, own.height) == (camera.width, camera.height):
            return self
        return Canvas(camera, self.supersampling)

    def camera_rays(self) -> Float64[np.ndarray, "height width 2"]:
        """x and y at depth 1 of what the pixels of the camera see."""
        return self._rays.reshape(self._camera.height, self._camera.width, 2)

    def nearest(self, values: np.ndarray) -> np.ndarray:
        """Values of the canvas [height, width] next to the pixels of the camera."""
        if self._maps is None:
            return values[
                self.supersampling // 2 :: self.supersampling, self.supersampling // 2 :: self.supersampling
            ].copy()
        columns, rows = np.round(self._maps).astype(int).reshape(-1, 2).T
        height, width = values.shape
        return values[rows.clip(0, height - 1), columns.clip(0, width - 1)].reshape(self._maps.shape[:2])

    def smooth(self, picture: Float32[np.ndarray, "rows columns 3"]) -> Float32[np.ndarray, "height width 3"]:
        """Colors of the pixels of the camera."""
        cv2, size = require_opencv(), (self._camera.width, self._camera.height)
        if self._maps is None:
            return picture if self.supersampling == 1 else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        if self.supersampling > 1:
            picture = cv2.blur(picture, (self.supersampling, self.supersampling))
        return cv2.remap(picture, self._maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def depths(
        self,
        drawn: Float32[np.ndarray, "rows columns"],
        faces: Int32[np.ndarray, "height width"],
        planes: Float64[np.ndarray, "n 3"],
        limits: Float64[np.ndarray, "n 2"],
        ground: Float64[np.ndarray, " 3"],
    ) -> Float32[np.ndarray, "height width"]:
        """Depth of the camera's own pixels on these faces, or on the ground where there is none [m]; inf in the sky.

        Args:
          drawn: inverse depth of the pixels of the canvas, which may be those of the camera.
          planes, limits: of ``ZBuffer.draw``.
          ground: inverse depth of the ground is ground . (x, y, 1) of a ray at depth 1.
        """
        if self._maps is None and self.supersampling == 1:
            with np.errstate(divide="ignore"):
                return np.where(drawn > _LEAST, 1 / drawn, np.float32(np.inf))
        x, y = self._rays[:, 0], self._rays[:, 1]
        inverse = (ground[0] * x + ground[1] * y + ground[2]).clip(0, None)
        flat = faces.ravel()
        on_face = np.flatnonzero(flat >= 0)
        chosen = flat[on_face]
        of_rays = planes @ self.camera.intrinsic
        plane = of_rays[chosen]
        value = plane[:, 0] * x[on_face] + plane[:, 1] * y[on_face] + plane[:, 2]
        inverse[on_face] = value.clip(limits[chosen, 0], limits[chosen, 1])
        with np.errstate(divide="ignore"):
            return np.where(inverse > _LEAST, 1 / inverse, np.inf).astype(np.float32).reshape(faces.shape)
