"""Points, segments and faces in the frame of a camera -> pixels, in float64."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.camera.camera import Camera
from scjax.camera.clipping import clip_depth, clip_disc, clip_polygons, clip_rectangle
from scjax.camera.distortion import distort, max_radius, undistort, undistorted_radius

NEAR, FAR = 0.2, 80.0  # m
MARGIN = 8.0  # pixels beyond the border, so that ends of thick lines stay out of sight
_PIECE = 20.0  # pixels; longer segments are cut before a lens bends them


class ImagePoints(NamedTuple):
    """Projected points.

    Attributes:
      pixels: column and row; they mean nothing where not visible.
      depth: along the axis of the camera [m].
      visible: before the near plane, and where the lens maps points one to one. They may lie beside the picture.
    """

    pixels: Float64[np.ndarray, "*b 2"]
    depth: Float64[np.ndarray, "*b"]
    visible: Bool[np.ndarray, "*b"]


class ImageSegments(NamedTuple):
    """Visible parts of segments. A long segment behind a lens has several.

    Attributes:
      ends: pixels of both ends.
      inverse_depths: of both ends [1/m], linear along the segment in the picture.
      rows: index of the segment that each is a part of.
    """

    ends: Float64[np.ndarray, "n 2 2"]
    inverse_depths: Float64[np.ndarray, "n 2"]
    rows: Int[np.ndarray, " n"]


def project_points(camera: Camera, points: Float64[np.ndarray, "*b 3"], near: float = NEAR) -> ImagePoints:
    """Pixels of points in the frame of the camera [m]."""
    depth = points[..., 2]
    visible = depth >= near
    ideal = points[..., :2] / np.where(visible, depth, 1.0)[..., None]
    if camera.is_distorted:
        limit = max_radius(camera.distortion)
        visible = visible & (np.hypot(ideal[..., 0], ideal[..., 1]) <= limit)
        ideal = distort(np.where(visible[..., None], ideal, 0.0), camera.distortion)
    return ImagePoints(_to_pixels(camera, ideal), depth, visible)


def project_segments(
    camera: Camera,
    first: Float64[np.ndarray, "n 3"],
    second: Float64[np.ndarray, "n 3"],
    *,
    near: float = NEAR,
    far: float = FAR,
) -> ImageSegments:
    """Visible parts of segments, from their ends in the frame of the camera [m].

    They are cut at the near and the far plane, then where the lens folds back, then ``MARGIN`` beside the picture.
    """
    part = clip_depth(first[:, 2], second[:, 2], near, far)
    rows = np.flatnonzero(part.keep)
    ends = part.cut(first, second)[rows]
    inverse = 1 / ends[..., 2].clip(near, None)
    ideal = ends[..., :2] * inverse[..., None]
    if camera.is_distorted:
        disc = clip_disc(ideal[:, 0], ideal[:, 1], _visible_radius(camera))
        ideal, inverse = disc.cut(ideal[:, 0], ideal[:, 1]), disc.cut(inverse[:, 0], inverse[:, 1])
        ideal, inverse, rows = ideal[disc.keep], inverse[disc.keep], rows[disc.keep]
        ideal, inverse, rows = _cut_in_pieces(camera, ideal, inverse, rows)
        ideal = distort(ideal, camera.distortion)
    pixels = _to_pixels(camera, ideal)
    low, high = (-MARGIN, -MARGIN), (camera.width - 1 + MARGIN, camera.height - 1 + MARGIN)
    box = clip_rectangle(pixels[:, 0], pixels[:, 1], low, high)
    keep = box.keep
    return ImageSegments(
        box.cut(pixels[:, 0], pixels[:, 1])[keep], box.cut(inverse[:, 0], inverse[:, 1])[keep], rows[keep]
    )


def project_faces(
    camera: Camera, faces: Float64[np.ndarray, "n corners 3"], near: float = NEAR
) -> Float64[np.ndarray, "n more 2"]:
    """Pixels of the corners of flat convex faces, cut at the near plane and ``MARGIN`` beside the picture.

    There are five corners more; the last one is repeated where there are fewer. Faces out of sight are NaN. Sides stay
    straight: a lens moves corners only.
    """
    visible = clip_polygons(faces, np.array([0.0, 0.0, 1.0]), near)
    ideal = visible[..., :2] / visible[..., 2:]
    if camera.is_distorted:
        limit = _visible_radius(camera)
        radius = np.hypot(ideal[..., 0], ideal[..., 1])[..., None]
        ideal = distort(ideal * np.minimum(1.0, limit / np.maximum(radius, 1e-9)), camera.distortion)
    polygons = _to_pixels(camera, ideal)
    for axis, size in enumerate((camera.width, camera.height)):
        for sign in (1.0, -1.0):
            normal = np.zeros(2)
            normal[axis] = sign
            polygons = clip_polygons(polygons, normal, -MARGIN if sign > 0 else -(size - 1 + MARGIN))
    return polygons


def pixel_rays(camera: Camera, pixels: Float64[np.ndarray, "*b 2"]) -> Float64[np.ndarray, "*b 2"]:
    """x and y at depth 1 of what is seen at pixels; NaN where a lens shows nothing."""
    (fx, skew, cx), (_, fy, cy), _ = camera.intrinsic.tolist()
    y = (pixels[..., 1] - cy) / fy
    x = (pixels[..., 0] - cx - skew * y) / fx
    ideal = np.stack([x, y], -1)
    return undistort(ideal, camera.distortion) if camera.is_distorted else ideal


def _to_pixels(camera: Camera, ideal: np.ndarray) -> np.ndarray:
    return ideal @ camera.intrinsic[:2, :2].T + camera.intrinsic[:2, 2]


@functools.lru_cache(maxsize=64)
def _visible_radius(camera: Camera) -> float:
    """Distance from the axis at depth 1 beyond which a lens shows nothing inside the picture and its margin."""
    (fx, skew, cx), (_, fy, cy), _ = camera.intrinsic.tolist()
    right, bottom = camera.width - 1 + MARGIN, camera.height - 1 + MARGIN
    corners = np.array([[x, y] for x in (-MARGIN, right) for y in (-MARGIN, bottom)])
    y = (corners[:, 1] - cy) / fy
    x = (corners[:, 0] - cx - skew * y) / fx
    return 1.05 * float(undistorted_radius(np.hypot(x, y), camera.distortion).max())


def _cut_in_pieces(
    camera: Camera, ideal: np.ndarray, inverse: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Segments at depth 1 [n, 2, 2] cut so that none spans many pixels."""
    focal = max(camera.intrinsic[0, 0], camera.intrinsic[1, 1])
    lengths = focal * np.linalg.norm(ideal[:, 1] - ideal[:, 0], axis=-1)
    counts = np.ceil(lengths / _PIECE).clip(1, None).astype(int)
    index = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
    shares = np.stack([number / counts[index], (number + 1) / counts[index]], 1)
    first, change = ideal[index, :1], (ideal[:, 1:] - ideal[:, :1])[index]
    pieces = first + shares[..., None] * change
    return pieces, inverse[index, :1] + shares * (inverse[:, 1] - inverse[:, 0])[index, None], rows[index]
