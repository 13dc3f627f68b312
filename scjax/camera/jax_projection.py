"""The projection of ``scjax.camera.projection`` as jitted, differentiable JAX functions in float32, for any batch axes.

Coordinates of a map may be kilometers, which float32 holds to millimeters only: subtract an origin near the camera from
points and ``CameraParameters.position`` first, in float64.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from scjax.camera.camera import Camera
from scjax.camera.distortion import max_radius
from scjax.camera.projection import FAR, MARGIN, NEAR
from scjax.scene import AnyArray


class CameraParameters(NamedTuple):
    """A camera at a pose, as arrays.

    Attributes:
      intrinsic: as in ``Camera``.
      distortion: k1, k2, p1, p2, k3.
      max_radius: distance from the axis at depth 1 up to which the lens maps points one to one.
      size: width and height of the picture [pixels].
      rotation: its columns are the axes of the camera in the frame of the points.
      position: of the camera in that frame [m].
    """

    intrinsic: Float[AnyArray, "3 3"]
    distortion: Float[AnyArray, " 5"]
    max_radius: Float[AnyArray, ""]
    size: Float[AnyArray, " 2"]
    rotation: Float[AnyArray, "3 3"]
    position: Float[AnyArray, " 3"]


class JaxImagePoints(NamedTuple):
    """As ``ImagePoints``."""

    pixels: Float[Array, "*b 2"]
    depth: Float[Array, "*b"]
    visible: Bool[Array, "*b"]


class JaxImageSegments(NamedTuple):
    """The visible part of each segment: pixels of its ends, and whether there is one."""

    ends: Float[Array, "*b 2 2"]
    visible: Bool[Array, "*b"]


def camera_parameters(
    camera: Camera, rotation: Float[AnyArray, "3 3"], position: Float[AnyArray, " 3"]
) -> CameraParameters:
    """The arrays of a camera with the axes ``rotation`` (columns) at ``position``, as float32."""
    arrays = (
        *(camera.intrinsic, camera.distortion, min(max_radius(camera.distortion), 1e6)),
        *((camera.width, camera.height), rotation, position),
    )
    return CameraParameters(*(np.asarray(array, np.float32) for array in arrays))


@jax.jit
def project_points_jax(camera: CameraParameters, points: Float[AnyArray, "*b 3"], near: float = NEAR) -> JaxImagePoints:
    """Pixels of points [m]; those that are not visible have a harmless place and no gradient."""
    local = _in_camera(camera, points)
    depth = local[..., 2]
    visible = depth >= near
    ideal = jnp.where(visible[..., None], local[..., :2], 0.0) / jnp.where(visible, depth, 1.0)[..., None]
    visible = visible & (jnp.square(ideal).sum(-1) <= jnp.square(camera.max_radius))
    return JaxImagePoints(_pixels(camera, jnp.where(visible[..., None], ideal, 0.0)), depth, visible)


@jax.jit
def project_segments_jax(
    camera: CameraParameters,
    first: Float[AnyArray, "*b 3"],
    second: Float[AnyArray, "*b 3"],
    near: float = NEAR,
    far: float = FAR,
) -> JaxImageSegments:
    """Pixels of the ends of the visible parts of segments [m], cut as by ``project_segments`` of a pinhole.

    A lens moves the ends but does not bend what is between them: cut long segments first. Ends outside ``max_radius``
    make a segment invisible.
    """
    first, second = _in_camera(camera, first), _in_camera(camera, second)
    start, stop = jnp.zeros(first.shape[:-1]), jnp.ones(first.shape[:-1])
    start, stop = _cut(start, stop, first[..., 2] - near, second[..., 2] - near)
    start, stop = _cut(start, stop, far - first[..., 2], far - second[..., 2])
    # Borders of the picture are planes in space unless a lens bends them. Cutting there keeps the digits that ends far
    # beside the picture would cost.
    is_bent = (jnp.asarray(camera.distortion) != 0).any()
    for plane in _border_planes(camera):
        height, next_height = first @ plane, second @ plane
        start, stop = _cut(start, stop, jnp.where(is_bent, 1.0, height), jnp.where(is_bent, 1.0, next_height))
    visible = start <= stop
    change = second - first
    ends = jnp.stack([first + start[..., None] * change, second - (1 - stop)[..., None] * change], -2)
    depth = jnp.where(visible[..., None], jnp.maximum(ends[..., 2], near), 1.0)
    ideal = jnp.where(visible[..., None, None], ends[..., :2], 0.0) / depth[..., None]
    visible = visible & (jnp.square(ideal).sum(-1) <= jnp.square(camera.max_radius)).all(-1)
    pixels = _pixels(camera, jnp.where(visible[..., None, None], ideal, 0.0))
    one, other = pixels[..., 0, :], pixels[..., 1, :]
    start, stop = jnp.zeros(first.shape[:-1]), jnp.ones(first.shape[:-1])
    for axis in (0, 1):
        start, stop = _cut(start, stop, one[..., axis] + MARGIN, other[..., axis] + MARGIN)
        edge = jnp.asarray(camera.size)[axis] - 1 + MARGIN
        start, stop = _cut(start, stop, edge - one[..., axis], edge - other[..., axis])
    visible = visible & (start <= stop)
    change = other - one
    return JaxImageSegments(
        jnp.stack([one + start[..., None] * change, other - (1 - stop)[..., None] * change], -2), visible
    )


def _border_planes(camera: CameraParameters) -> list[Array]:
    """Normals of the planes through the camera and the borders of the picture with its margin; they point inwards."""
    intrinsic, size = jnp.asarray(camera.intrinsic), jnp.asarray(camera.size)
    planes = []
    for axis in (0, 1):
        low = intrinsic[axis].at[2].add(MARGIN)
        planes += [low, -intrinsic[axis].at[2].add(1 - MARGIN - size[axis])]
    return planes


def _in_camera(camera: CameraParameters, points: AnyArray) -> Array:
    points = jnp.asarray(points)
    return (points - _expanded(jnp.asarray(camera.position), points.ndim)) @ jnp.asarray(camera.rotation)


def _expanded(vector: Array, rank: int) -> Array:
    return vector.reshape((1,) * (rank - 1) + vector.shape)


def _pixels(camera: CameraParameters, ideal: Array) -> Array:
    k1, k2, p1, p2, k3 = jnp.asarray(camera.distortion)
    x, y = ideal[..., 0], ideal[..., 1]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    cross = 2 * x * y
    bent = [x * radial + p1 * cross + p2 * (square + 2 * x * x), y * radial + p1 * (square + 2 * y * y) + p2 * cross]
    intrinsic = jnp.asarray(camera.intrinsic)
    return jnp.stack(bent, -1) @ intrinsic[:2, :2].T + _expanded(intrinsic[:2, 2], ideal.ndim)


def _cut(start: Array, stop: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """The range of shares cut to where a value that goes from ``first`` to ``second`` is not negative."""
    change = second - first
    flat = jnp.abs(change) < 1e-9
    share = -first / jnp.where(flat, 1.0, change)
    outside = flat & (first < 0)
    start = jnp.where(outside, 1.0, jnp.where(~flat & (change > 0), jnp.maximum(start, share), start))
    return start, jnp.where(outside, 0.0, jnp.where(~flat & (change < 0), jnp.minimum(stop, share), stop))
