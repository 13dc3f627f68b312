"""Kinds of lanes and agents that the denoiser may be given: what each one is, roughly.

A kind is a whole number made of a few small ones, its digits: for a lane its direction, turn, signal, joints, level,
side of the ego and length; for an agent its class, speed, direction, whether it is on a lane, and its side of the ego.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, Real

from scjax.models.codec import SceneCodec
from scjax.scene import TILE_SIZE, AgentType, Crop, Link, Scene, Signal
from scjax.scene.angles import wrap_to_pi
from scjax.scene.per_type import PerType
from scjax.scene.scene import LARGE_LENGTH, AnyArray

NO_KIND = -1
"""Kind of an element about which the network decides, and of padding."""

LANE_DIGITS = (8, 9, len(Signal), 5, 3, 4, 3)
"""Sizes of a lane's digits: direction at its start, turn, signal, joints, level, side of the ego, length."""

SECTORS = 8
"""Of directions; the middle of sector 0 is that of the ego."""

# Besides the class: speed, direction, on a lane, side of the ego, distance from it.
_AGENT_DIGITS = (4, SECTORS, 4, 5, 3)

_SPEED, _COS, _LENGTH = 3, 4, 6  # columns of the agents
_TURNS = tuple(np.deg2rad((-60.0, -25.0, -12.0, -5.0, 5.0, 12.0, 25.0, 60.0)).tolist())  # between the classes of turns
_MIN_LEVEL = 3.0  # m above or below the ego's ground
_BORDER = 2.0  # m from the window's border, where lanes are cut
_LENGTHS = (10.0, 25.0)  # m
_SPEEDS = (0.5, 4.0, 12.0)  # m/s
_DISTANCES = (10.0, 20.0)  # m from the ego
FAR = len(_DISTANCES)
"""Last digit of agents that are far from the ego."""

_ON_LANE = 1.4  # m from the middle of a lane
_ALONG = 0.7  # cosine of the angle to a lane, above which an agent goes along it
_NEAR = 3.0  # m between a box center and the points of its lane
_SIDE = 1.8  # m to the left or right of the ego
_MOST_BESIDE = 5.4  # m, agents of the next lane
_ROAD = 14.0  # m, lanes of the ego's road
_ABREAST = 2.0  # m ahead of or behind the ego


def agent_digits(codec: SceneCodec) -> tuple[int, ...]:
    """Sizes of an agent's digits. The first is its class: those of the codec, and last the large vehicles."""
    return (len(codec.agent_types) + 1, *_AGENT_DIGITS)


def lane_kinds(scene: Scene) -> Int[Array, "*b lanes"]:
    """The kind of every lane of scenes in meters; ``NO_KIND`` at padding."""
    lanes, links = jnp.asarray(scene.lanes), jnp.asarray(scene.links)
    steps = lanes[..., 1:, :2] - lanes[..., :-1, :2]
    headings = jnp.arctan2(steps[..., 1], steps[..., 0])
    turn = wrap_to_pi(headings[..., 1:] - headings[..., :-1]).sum(-1)
    level = lanes[..., 2].mean(-1)
    digits = (
        sectors_of(headings[..., 0]),
        _class_of(turn, _TURNS),
        jnp.asarray(scene.signals),
        _joints(lanes[..., -1, :2], links, jnp.asarray(scene.crop)),
        jnp.where(level > _MIN_LEVEL, 1, jnp.where(level < -_MIN_LEVEL, 2, 0)),
        _side_of_lanes(scene),
        _class_of(jnp.hypot(steps[..., 0], steps[..., 1]).sum(-1), _LENGTHS),
    )
    return jnp.where(scene.lane_mask, _kind(digits, LANE_DIGITS), NO_KIND)


def agent_kinds(scene: Scene, codec: SceneCodec) -> Int[Array, "*b agents"]:
    """The kind of every agent of scenes in meters; ``NO_KIND`` at padding and for classes unknown to the codec."""
    class_of = np.full(len(AgentType), NO_KIND, np.int32)
    class_of[list(codec.agent_types)] = np.arange(len(codec.agent_types))
    agents, types = jnp.asarray(scene.agents), jnp.asarray(scene.agent_types)
    is_large = (types == AgentType.VEHICLE) & (agents[..., _LENGTH] > LARGE_LENGTH)
    from_ego = _from_ego(agents[..., :2], scene)
    classes = jnp.where(is_large, len(codec.agent_types), jnp.asarray(class_of)[types])
    digits = (
        classes,
        _class_of(agents[..., _SPEED], _SPEEDS),
        sectors_of(jnp.arctan2(agents[..., _COS + 1], agents[..., _COS])),
        _on_lane(agents, scene),
        sides_of_ego(from_ego),
        distances_from_ego(from_ego),
    )
    known = scene.agent_mask & (classes != NO_KIND)
    return jnp.where(known, _kind(digits, agent_digits(codec)), NO_KIND)


def scene_kinds(scene: Scene, codec: SceneCodec) -> PerType:
    """The kinds of all tokens of scenes in meters."""
    return PerType(agents=agent_kinds(scene, codec), lanes=lane_kinds(scene))


def digits_of(kinds: Int[AnyArray, "*n"], sizes: Sequence[int]) -> list[Int[AnyArray, "*n"]]:
    """The digits of kinds, one array each."""
    steps = [math.prod(sizes[:place]) for place in range(len(sizes))]
    return [kinds // step % size for step, size in zip(steps, sizes, strict=True)]


def _kind(digits: Sequence[Array], sizes: Sequence[int]) -> Int[Array, "*n"]:
    """The first digit counts ones."""
    total, step = 0, 1
    for digit, size in zip(digits, sizes, strict=True):
        total, step = total + step * jnp.asarray(digit, jnp.int32), step * size
    return jnp.asarray(total)


def sectors_of(angle: Real[AnyArray, "*n"]) -> Int[Array, "*n"]:
    """Which of ``SECTORS`` equal sectors a direction [rad] is in, counter-clockwise."""
    return jnp.round(jnp.asarray(angle) / (2 * np.pi / SECTORS)).astype(jnp.int32) % SECTORS


def _joints(ends: Real[Array, "*b lanes 2"], links: Int[Array, "*b lanes lanes"], crop: Int[Array, "*b"]):
    """0: none of these; 1: splits; 2: merges; 3: both; 4: ends inside the window."""
    after, before = (links == Link.PREDECESSOR).sum(-1), (links == Link.SUCCESSOR).sum(-1)
    middle = jnp.where(crop == Crop.FORWARD, TILE_SIZE / 2, 0.0)[..., None]
    reach = jnp.maximum(jnp.abs(ends[..., 0] - middle), jnp.abs(ends[..., 1]))
    ends_inside = (after == 0) & (reach < TILE_SIZE / 2 - _BORDER)
    return jnp.where(ends_inside, 4, (after > 1) + 2 * (before > 1))


def _on_lane(agents: Real[Array, "*b agents columns"], scene: Scene) -> Int[Array, "*b agents"]:
    """0: on no lane; 1: in the middle of one and along it; 2: across; 3: against it. By the nearest point of a lane."""
    lanes, centers = jnp.asarray(scene.lanes)[..., :2], agents[..., :2]
    if not lanes.shape[-3]:
        return jnp.zeros(centers.shape[:-1], jnp.int32)
    steps = lanes[..., 1:, :] - lanes[..., :-1, :]
    shape = (*lanes.shape[:-3], 1, lanes.shape[-3] * lanes.shape[-2], 2)
    points, headings = lanes.reshape(shape), jnp.concatenate([steps, steps[..., -1:, :]], -2).reshape(shape)
    offsets = centers[..., :, None, :] - points
    squares = jnp.where(_of_points(scene.lane_mask, lanes.shape[-2]), (offsets**2).sum(-1), jnp.inf)
    nearest = squares.argmin(-1, keepdims=True)[..., None]
    offset = jnp.take_along_axis(offsets, nearest, -2)[..., 0, :]
    heading = jnp.take_along_axis(jnp.broadcast_to(headings, offsets.shape), nearest, -2)[..., 0, :]
    across = offset[..., 0] * heading[..., 1] - offset[..., 1] * heading[..., 0]
    length = jnp.hypot(heading[..., 0], heading[..., 1])
    is_in_middle = (jnp.abs(across) <= _ON_LANE * length) & (squares.min(-1) < _NEAR**2)
    along = agents[..., _COS] * heading[..., 0] + agents[..., _COS + 1] * heading[..., 1]
    direction = jnp.where(along > _ALONG * length, 1, jnp.where(along < -_ALONG * length, 3, 2))
    return jnp.where(is_in_middle, direction, 0)


def _of_points(lane_mask: Bool[AnyArray, "*b lanes"], points: int) -> Bool[Array, "*b 1 rows"]:
    return jnp.repeat(jnp.asarray(lane_mask), points, axis=-1)[..., None, :]


def _from_ego(points: Real[Array, "*b n 2"], scene: Scene) -> Real[Array, "*b n 2"]:
    """Points in the frame of agent 0, or as they are where there is none: the ego is at the origin then."""
    if not scene.agents.shape[-2]:
        return points
    ego, is_there = jnp.asarray(scene.agents)[..., :1, :], jnp.asarray(scene.agent_mask)[..., :1, None]
    offsets, cos, sin = points - ego[..., :2], ego[..., _COS], ego[..., _COS + 1]
    x, y = offsets[..., 0], offsets[..., 1]
    return jnp.where(is_there, jnp.stack([cos * x + sin * y, cos * y - sin * x], -1), points)


def sides_of_ego(points: Real[AnyArray, "*n 2"]) -> Int[Array, "*n"]:
    """Of points in the frame of the ego: 1 ahead; 2 behind; 3, 4 in the lane to its left, right; 0 else."""
    x, y = jnp.moveaxis(jnp.asarray(points), -1, 0)
    beside = jnp.where(jnp.abs(y) > _MOST_BESIDE, 0, jnp.where(y > 0, 3, 4))
    return jnp.where(jnp.abs(y) < _SIDE, jnp.where(x > 0, 1, 2), beside)


def distances_from_ego(points: Real[AnyArray, "*n 2"]) -> Int[Array, "*n"]:
    """The class of distance of points in the frame of the ego, 0 to ``FAR``."""
    return _class_of(jnp.hypot(*jnp.moveaxis(jnp.asarray(points), -1, 0)), _DISTANCES)


def _side_of_lanes(scene: Scene) -> Int[Array, "*b lanes"]:
    """0: none of these; 1: below the ego; 2: abreast to its left; 3: to its right."""
    lanes = jnp.asarray(scene.lanes)[..., :2]
    points = _from_ego(lanes.reshape(*lanes.shape[:-3], -1, 2), scene).reshape(lanes.shape)
    nearest = jnp.abs(points[..., 0]).argmin(-1, keepdims=True)[..., None]
    x, y = jnp.moveaxis(jnp.take_along_axis(points, nearest, -2)[..., 0, :], -1, 0)
    beside = jnp.where(y > 0, 2, 3)
    is_abreast = (jnp.abs(x) < _ABREAST) & (jnp.abs(y) < _ROAD)
    return jnp.where(is_abreast, jnp.where(jnp.abs(y) < _SIDE, 1, beside), 0)


def _class_of(values: Real[Array, "*n"], limits: Sequence[float]) -> Int[Array, "*n"]:
    """How many limits a value reaches."""
    return jnp.stack([values >= limit for limit in limits]).sum(0, dtype=jnp.int32)
