"""Frames, polylines and oriented boxes: masked, jitted and differentiable, with any leading batch axes.

A planar pose is (x, y, yaw) of a frame in its parent, [*b, 3]; applying it takes points of the frame into the parent.
Batch axes of a pose must equal the leading axes of its argument; missing ones are added on the right.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from scjax.scene import AnyArray, Scene

Values = Float[AnyArray, "..."]


def wrap_angle(angle: Float[AnyArray, "*b"]) -> Float[Array, "*b"]:
    """Angles [rad] brought into (-pi, pi]."""
    return jnp.pi - jnp.mod(jnp.pi - jnp.asarray(angle), 2 * jnp.pi)


# --- planar frames -----------------------------------------------------------------------------------------------


def se2_apply(pose: Float[AnyArray, "... 3"], points: Float[AnyArray, "... 2"]) -> Float[Array, "... 2"]:
    """Points [*b, ..., 2] of the frame at ``pose`` [*b, 3], in the parent's coordinates."""
    pose = _expand(pose, jnp.ndim(points) - 1, 1)
    return se2_rotate(pose[..., 2], points) + pose[..., :2]


def se2_rotate(yaw: Values, vectors: Float[AnyArray, "... 2"]) -> Float[Array, "... 2"]:
    """Vectors [*b, ..., 2] rotated by ``yaw`` [*b] counter-clockwise [rad]."""
    vectors, yaw = jnp.asarray(vectors), _expand(yaw, jnp.ndim(vectors) - 1, 0)
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    x, y = vectors[..., 0], vectors[..., 1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], -1)


def se2_compose(outer: Float[AnyArray, "*b 3"], inner: Float[AnyArray, "*b 3"]) -> Float[Array, "*b 3"]:
    """The pose ``inner`` of the frame ``outer``, expressed in the parent of ``outer``."""
    outer, inner = jnp.asarray(outer), jnp.asarray(inner)
    return jnp.concatenate([se2_apply(outer, inner[..., :2]), wrap_angle(outer[..., 2:] + inner[..., 2:])], -1)


def se2_inverse(pose: Float[AnyArray, "*b 3"]) -> Float[Array, "*b 3"]:
    """The pose of the parent in the frame: ``se2_compose(pose, se2_inverse(pose))`` is zero."""
    pose = jnp.asarray(pose)
    return jnp.concatenate([se2_rotate(-pose[..., 2], -pose[..., :2]), wrap_angle(-pose[..., 2:])], -1)


# --- spatial frames: rotation matrix [*b, 3, 3] and translation [*b, 3] -------------------------------------------


def matrix_from_quaternion(quaternion: Float[AnyArray, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix of a quaternion (w, x, y, z) of any non-zero length."""
    quaternion = jnp.asarray(quaternion)
    w, x, y, z = jnp.moveaxis(quaternion / jnp.sqrt(jnp.square(quaternion).sum(-1, keepdims=True)), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def matrix_from_yaw(yaw: Float[AnyArray, "*b"]) -> Float[Array, "*b 3 3"]:
    """Matrix of a counter-clockwise rotation about z by ``yaw`` [rad]."""
    half = jnp.asarray(yaw) / 2
    return matrix_from_quaternion(jnp.stack([jnp.cos(half), 0 * half, 0 * half, jnp.sin(half)], -1))


def se3_apply(
    rotation: Float[AnyArray, "... 3 3"],
    translation: Float[AnyArray, "... 3"],
    points: Float[AnyArray, "... 3"],
) -> Float[Array, "... 3"]:
    """Points [*b, ..., 3] of the frame with this rotation and origin, in the parent's coordinates."""
    rank = jnp.ndim(points) - 1
    rotated = (_expand(rotation, rank, 2) * jnp.asarray(points)[..., None, :]).sum(-1)
    return rotated + _expand(translation, rank, 1)


def se3_compose(
    outer: tuple[Float[AnyArray, "*b 3 3"], Float[AnyArray, "*b 3"]],
    inner: tuple[Float[AnyArray, "*b 3 3"], Float[AnyArray, "*b 3"]],
) -> tuple[Float[Array, "*b 3 3"], Float[Array, "*b 3"]]:
    """The frame (rotation, translation) ``inner`` of the frame ``outer``, expressed in the parent of ``outer``."""
    rotation = (jnp.asarray(outer[0])[..., :, :, None] * jnp.asarray(inner[0])[..., None, :, :]).sum(-2)
    return rotation, se3_apply(*outer, inner[1])


def se3_inverse(
    rotation: Float[AnyArray, "*b 3 3"], translation: Float[AnyArray, "*b 3"]
) -> tuple[Float[Array, "*b 3 3"], Float[Array, "*b 3"]]:
    """Rotation and translation of the parent in the frame."""
    back = jnp.swapaxes(jnp.asarray(rotation), -1, -2)
    return back, -(back * jnp.asarray(translation)[..., None, :]).sum(-1)


# --- scenes ------------------------------------------------------------------------------------------------------


@jax.jit
def move(scene: Scene, pose: Float[AnyArray, "*b 3"]) -> Scene:
    """A scene of the frame at ``pose`` (x, y, yaw), in the parent's coordinates; padding stays zero.

    To see a scene from an agent at pose p, move it by ``se2_inverse(p)``. The crop field does not change.
    """
    agents, lanes = jnp.asarray(scene.agents), jnp.asarray(scene.lanes)
    agents = agents.at[..., :2].set(se2_apply(pose, agents[..., :2]))
    agents = agents.at[..., 4:6].set(se2_rotate(jnp.asarray(pose)[..., 2], agents[..., 4:6]))
    lanes = lanes.at[..., :2].set(se2_apply(pose, lanes[..., :2]))
    return _replace_states(scene, agents, lanes)


@jax.jit
def move_se3(scene: Scene, rotation: Float[AnyArray, "*b 3 3"], translation: Float[AnyArray, "*b 3"]) -> Scene:
    """As ``move`` for a spatial frame. Boxes stay upright: the heading is the ground direction of the rotated box axis.

    Unknown z values are moved like known ones; ``*_known`` does not change.
    """
    agents = jnp.asarray(scene.agents)
    flat = jnp.zeros_like(agents[..., :1])
    axis = se3_apply(rotation, jnp.zeros_like(jnp.asarray(translation)), jnp.concatenate([agents[..., 4:6], flat], -1))
    length = _safe_sqrt(jnp.square(axis[..., :2]).sum(-1, keepdims=True))
    agents = agents.at[..., :3].set(se3_apply(rotation, translation, agents[..., :3]))
    agents = agents.at[..., 4:6].set(axis[..., :2] / jnp.maximum(length, 1e-9))
    return _replace_states(scene, agents, se3_apply(rotation, translation, scene.lanes))


def _replace_states(scene: Scene, agents: Array, lanes: Array) -> Scene:
    agent_mask, lane_mask = jnp.asarray(scene.agent_mask), jnp.asarray(scene.lane_mask)
    return scene.replace(
        agents=jnp.where(agent_mask[..., None], agents, 0.0), lanes=jnp.where(lane_mask[..., None, None], lanes, 0.0)
    )


# --- polylines ---------------------------------------------------------------------------------------------------


def arc_length(
    points: Float[AnyArray, "*b points dims"], mask: Bool[AnyArray, "*b points"] | None = None
) -> Float[Array, "*b points"]:
    """Distance along the polyline to every point, over x and y only [m].

    ``mask`` marks the leading points that are real; after them the arc length stays at its end value.
    """
    points = jnp.asarray(points)
    steps = _safe_sqrt(jnp.square(jnp.diff(points[..., :2], axis=-2)).sum(-1))
    if mask is not None:
        steps = jnp.where(jnp.asarray(mask)[..., 1:], steps, 0.0)
    return jnp.concatenate([jnp.zeros_like(points[..., :1, 0]), jnp.cumsum(steps, -1)], -1)


@functools.partial(jax.jit, static_argnames="num_points")
def resample(
    points: Float[AnyArray, "*b points dims"],
    num_points: int,
    mask: Bool[AnyArray, "*b points"] | None = None,
) -> Float[Array, "*b num_points dims"]:
    """``num_points`` >= 2 points equally spaced in xy arc length; further columns (z) follow the same parameter.

    ``mask`` marks the leading points that are real. A polyline of one point or of length 0 repeats its first point.
    """
    points = jnp.asarray(points)
    arc = arc_length(points, mask)
    last = points.shape[-2] - 1 if mask is None else jnp.asarray(mask).sum(-1, keepdims=True) - 1
    target = arc[..., -1:] * _leading(np.linspace(0, 1, num_points), arc.ndim)
    # Index of the segment that holds each target, by counting: searchsorted has no batch axes.
    segment = (arc[..., None, 1:] <= target[..., :, None]).sum(-1)
    segment = jnp.clip(segment, 0, jnp.maximum(last - 1, 0))
    start, end = (jnp.take_along_axis(arc, index, -1) for index in (segment, segment + 1))
    span = end - start
    share = jnp.where(span > 0, (target - start) / jnp.where(span > 0, span, 1.0), 0.0)[..., None]
    first, second = (jnp.take_along_axis(points, index[..., None], -2) for index in (segment, segment + 1))
    # With a single real point the second one is padding, and an infinite one would turn 0 * inf into NaN.
    return first + share * jnp.where(share > 0, second - first, 0.0)


@jax.jit
def distance_to_polylines(
    points: Float[AnyArray, "*b n 2"],
    polylines: Float[AnyArray, "*b lines points dims"],
    line_mask: Bool[AnyArray, "*b lines"] | None = None,
) -> Float[Array, "*b n lines"]:
    """Exact distance in the plane from every point to every polyline (nearest point of any segment) [m].

    Masked polylines are infinitely far away.
    """
    lines = jnp.asarray(polylines)[..., None, :, :, :2]  # [*b, 1, lines, points, 2]
    start, along = lines[..., :-1, :], jnp.diff(lines, axis=-2)
    offset = jnp.asarray(points)[..., :, None, None, :] - start
    square = jnp.square(along).sum(-1)
    share = (offset * along).sum(-1) / jnp.where(square > 0, square, 1.0)
    nearest = jnp.clip(share, 0, 1)[..., None] * along
    distance = _safe_sqrt(jnp.square(offset - nearest).sum(-1).min(-1))
    if line_mask is None:
        return distance
    return jnp.where(jnp.asarray(line_mask)[..., None, :], distance, jnp.inf)


# --- oriented boxes ----------------------------------------------------------------------------------------------


def box_corners(agents: Float[AnyArray, "*b n 9"]) -> Float[Array, "*b n 4 2"]:
    """Ground corners of agent boxes, counter-clockwise: front left, rear left, rear right, front right [m]."""
    agents = jnp.asarray(agents)
    nose = agents[..., 4:6] * agents[..., 6:7] / 2
    flank = jnp.stack([-agents[..., 5], agents[..., 4]], -1) * agents[..., 7:8] / 2
    corners = jnp.stack([nose + flank, flank - nose, -nose - flank, nose - flank], -2)
    return agents[..., None, :2] + corners


@jax.jit
def box_penetration(
    agents: Float[AnyArray, "*b n 9"], mask: Bool[AnyArray, "*b n"] | None = None
) -> Float[Array, "*b n n"]:
    """Penetration depth of every pair of boxes by the separating axis theorem [m]; -inf for masked pairs and itself.

    Positive: the smallest shift that separates the two boxes. Negative: they are apart by at least that much.
    """
    agents = jnp.asarray(agents)
    corners = box_corners(agents)
    ahead = agents[..., 4:6]
    axes = jnp.stack([ahead, jnp.stack([-ahead[..., 1], ahead[..., 0]], -1)], -2)  # [*b, n, 2 axes, 2]
    # [*b, box of the axis i, axis, box j, corner]: all corners on the two axes of every box.
    reach = (axes[..., :, :, None, None, :] * corners[..., None, None, :, :, :]).sum(-1)
    low, high = reach.min(-1), reach.max(-1)
    center = (agents[..., None, :2] * axes).sum(-1)[..., None]
    half = agents[..., 6:8][..., None] / 2
    depth = (jnp.minimum(high, center + half) - jnp.maximum(low, center - half)).min(-2)
    depth = jnp.minimum(depth, jnp.swapaxes(depth, -1, -2))
    allowed = _leading(~np.eye(agents.shape[-2], dtype=bool), depth.ndim)
    if mask is not None:
        real = jnp.asarray(mask)
        allowed = allowed & real[..., :, None] & real[..., None, :]
    return jnp.where(allowed, depth, -jnp.inf)


def boxes_overlap(
    agents: Float[AnyArray, "*b n 9"], mask: Bool[AnyArray, "*b n"] | None = None
) -> Bool[Array, "*b n n"]:
    """Which pairs of boxes share ground area (touching is not enough); False for masked boxes and for itself."""
    return box_penetration(agents, mask) > 0


def _safe_sqrt(square: Array) -> Array:
    """Square root whose gradient at 0 is 0 instead of infinite: padding has segments of no length."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _expand(array: Values, rank: int, own: int) -> Array:
    """``array`` [*b, own axes] with unit axes after ``*b``, to broadcast against ``rank`` leading axes."""
    array = jnp.asarray(array)
    lead = array.shape[: array.ndim - own]
    if len(lead) > rank:
        raise ValueError(
            f"a frame with batch axes {lead} cannot be applied to an array of {rank} leading axes: drop some of them"
        )
    return array.reshape(*lead, *(1,) * (rank - len(lead)), *array.shape[array.ndim - own :])


def _leading(array: np.ndarray, rank: int) -> Array:
    """``array`` with leading unit axes up to ``rank``."""
    return jnp.asarray(array.reshape((1,) * (rank - array.ndim) + array.shape))
