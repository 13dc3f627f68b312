"""Faces in a picture with exact hidden surfaces: the nearest face at every pixel."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, Int32

from scjax.camera.agent_boxes import FACES, face_normals, visible_faces
from scjax.camera.camera import Camera
from scjax.camera.projection import project_faces
from scjax.camera.raster import require_opencv

NO_FACE = -1
_SHIFT, _UNIT = 4, 16.0
_SMALLEST = 0.4  # pixels; faces that are smaller both ways are left out


class ZBuffer:
    """The nearest face at every pixel of a pinhole camera.

    Args:
      camera: without distortion.
      background: inverse depth of what is behind everything, such as the ground, 0 for the sky [1/m].

    Attributes:
      inverse_depth: of the nearest surface [1/m].
      faces: number of the nearest face, ``NO_FACE`` for the background.
    """

    inverse_depth: Float32[np.ndarray, "height width"]
    faces: Int32[np.ndarray, "height width"]

    def __init__(self, camera: Camera, background: Float32[np.ndarray, "height width"]):
        self._camera = camera
        self.inverse_depth = background.copy()
        self.faces = np.full(background.shape, NO_FACE, np.int32)

    def draw(
        self,
        polygons: Float64[np.ndarray, "n 9 2"],
        planes: Float64[np.ndarray, "n 3"],
        limits: Float64[np.ndarray, "n 2"],
    ) -> None:
        """Draws faces; face k gets the number k.

        Args:
          polygons: corners in the picture, the last one repeated [pixels].
          planes: inverse depth is planes . (column, row, 1) [1/m].
          limits: least and largest inverse depth of each face [1/m].
        """
        cv2 = require_opencv()
        height, width = self.faces.shape
        fixed = np.round(polygons * _UNIT).astype(np.int32)
        low = np.floor(polygons.min(1)).astype(int).clip(0, None)
        high = (np.ceil(polygons.max(1)).astype(int) + 1).clip(None, (width, height))
        order = np.argsort(-limits[:, 1])  # near faces first: those that they hide are skipped early
        columns, rows = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
        slopes, floors, tops = planes.astype(np.float32).tolist(), limits[:, 0].tolist(), limits[:, 1].tolist()
        boxes = np.concatenate([low, high], 1).tolist()
        corners = fixed.copy()
        corners -= np.round(low * _UNIT).astype(np.int32)[:, None]
        mask_buffer = np.zeros((height, width), np.uint8)
        for face in order.tolist():
            left, top, right, bottom = boxes[face]
            if right <= left or bottom <= top:
                continue
            depth = self.inverse_depth[top:bottom, left:right]
            if tops[face] < depth.min():
                continue
            mask = mask_buffer[: bottom - top, : right - left]
            mask[...] = 0
            cv2.fillConvexPoly(mask, corners[face], 1, cv2.LINE_8, _SHIFT)
            across, down, constant = slopes[face]
            plane = across * columns[left:right] + (down * rows[top:bottom] + constant)
            np.minimum(plane, tops[face], out=plane)
            np.maximum(plane, floors[face], out=plane)
            nearer = (plane > depth) & mask.view(bool)
            np.copyto(depth, plane, where=nearer)
            np.copyto(self.faces[top:bottom, left:right], face, where=nearer)


def picture_faces(
    camera: Camera, corners: Float64[np.ndarray, "n 8 3"], near: float
) -> tuple[
    Int[np.ndarray, " m"],
    Int[np.ndarray, " m"],
    Float64[np.ndarray, "m 9 2"],
    Float64[np.ndarray, "m 3"],
    Float64[np.ndarray, "m 2"],
]:
    """Visible faces of solids whose corners are given in the frame of a camera.

    Returns:
      Index of the solid, face, corners in the picture, plane and limits of inverse depth as of ``ZBuffer.draw``.
    """
    inside = np.flatnonzero(in_sight(camera, corners, near))
    solid, face = np.nonzero(visible_faces(corners[inside]))
    solid = inside[solid]
    quads = corners[solid[:, None], FACES[face]]
    ahead = quads[..., 2].max(1, initial=-np.inf) > near
    solid, face, quads = solid[ahead], face[ahead], quads[ahead]
    polygons = _polygons(camera, quads, near)
    extent = np.ptp(polygons, axis=1).max(1, initial=0.0)
    seen = np.isfinite(polygons).all((1, 2)) & (extent > _SMALLEST)
    solid, face, quads, polygons = solid[seen], face[seen], quads[seen], polygons[seen]
    normals = face_normals(quads)
    distance = (normals * quads[:, 0]).sum(-1)
    plane = normals / np.where(np.abs(distance) < 1e-12, -1e-12, distance)[:, None]
    depths = quads[..., 2].clip(near, None)
    limits = np.stack([1 / depths.max(1, initial=near), 1 / depths.min(1, initial=np.inf)], -1)
    return solid, face, polygons, pixel_planes(camera, plane), limits


def _polygons(camera: Camera, quads: np.ndarray, near: float) -> np.ndarray:
    """Corners of faces in the picture; only those that reach over its border or the near plane are cut."""
    depth = quads[..., 2:]
    pixels = quads[..., :2] / np.maximum(depth, near) @ camera.intrinsic[:2, :2].T + camera.intrinsic[:2, 2]
    within = (pixels >= 0) & (pixels <= (camera.width - 1, camera.height - 1)) & (depth >= near)
    whole = within.all((1, 2))
    polygons = np.empty((len(quads), 9, 2))
    polygons[whole] = pixels[whole][:, [0, 1, 2, 3, 3, 3, 3, 3, 3]]
    polygons[~whole] = project_faces(camera, quads[~whole], near)
    return polygons


def pixel_planes(camera: Camera, planes: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Functions planes . (x, y, 1) of a ray at depth 1 as functions of (column, row, 1)."""
    return planes @ np.linalg.inv(camera.intrinsic)


def plane_values(plane: Float64[np.ndarray, " 3"], width: int, height: int) -> Float32[np.ndarray, "height width"]:
    """plane . (column, row, 1) of all pixels."""
    across, down, constant = plane.astype(np.float32)
    columns, rows = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
    return across * columns + (down * rows + constant)[:, None]


def in_sight(camera: Camera, corners: Float64[np.ndarray, "n corners 3"], near: float) -> Bool[np.ndarray, " n"]:
    """Which groups of corners, in the frame of a camera, lie not wholly beyond one border or the near plane."""
    (fx, _, cx), (_, fy, cy), _ = camera.intrinsic.tolist()
    x, y, z = corners[..., 0], corners[..., 1], corners[..., 2]
    borders = (
        fx * x + (cx + 1) * z,
        (camera.width - cx) * z - fx * x,
        fy * y + (cy + 1) * z,
        (camera.height - cy) * z - fy * y,
    )
    beyond = np.any([(border < 0).all(1) for border in borders], 0)
    return (z.max(1, initial=-np.inf) > near) & ~beyond
