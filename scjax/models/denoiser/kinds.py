"""Kinds of lanes and agents that the denoiser may be given: what each one is, roughly, but not where.

A kind is a whole number made of a few small ones, its digits: for a lane its direction, turn, signal, joints and level;
for an agent its class, whether it stands, its direction and whether it is on a lane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Real

from scjax.models.codec import SceneCodec
from scjax.scene import TILE_SIZE, AgentType, Crop, Link, Scene, Signal
from scjax.scene.angles import wrap_to_pi
from scjax.scene.scene import LARGE_LENGTH

NO_KIND = -1
"""Kind of an element about which the network decides, and of padding."""

LANE_DIGITS = (4, 3, len(Signal), 5, 3)
"""Sizes of a lane's digits: direction at its start, turn, signal, joints, level."""

_AGENT_DIGITS = (2, 4, 2)  # besides the class: stands or not, direction, on a lane or not

_SPEED, _COS, _LENGTH = 3, 4, 6  # columns of the agents
_MIN_TURN = np.deg2rad(25.0)
_MIN_LEVEL = 3.0  # m above or below the ego's ground
_BORDER = 2.0  # m from the window's border, where lanes are cut
_STANDING = 0.5  # m/s
_ON_LANE = 2.3  # m between the box center and the nearest point of a lane


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
        _quadrant(headings[..., 0]),
        jnp.where(turn > _MIN_TURN, 1, jnp.where(turn < -_MIN_TURN, 2, 0)),
        jnp.asarray(scene.signals),
        _joints(lanes[..., -1, :2], links, jnp.asarray(scene.crop)),
        jnp.where(level > _MIN_LEVEL, 1, jnp.where(level < -_MIN_LEVEL, 2, 0)),
    )
    return jnp.where(scene.lane_mask, _kind(digits, LANE_DIGITS), NO_KIND)


def agent_kinds(scene: Scene, codec: SceneCodec) -> Int[Array, "*b agents"]:
    """The kind of every agent of scenes in meters; ``NO_KIND`` at padding and for classes unknown to the codec."""
    class_of = np.full(len(AgentType), NO_KIND, np.int32)
    class_of[list(codec.agent_types)] = np.arange(len(codec.agent_types))
    agents, types = jnp.asarray(scene.agents), jnp.asarray(scene.agent_types)
    is_large = (types == AgentType.VEHICLE) & (agents[..., _LENGTH] > LARGE_LENGTH)
    classes = jnp.where(is_large, len(codec.agent_types), jnp.asarray(class_of)[types])
    digits = (
        classes,
        agents[..., _SPEED] < _STANDING,
        _quadrant(jnp.arctan2(agents[..., _COS + 1], agents[..., _COS])),
        _is_on_lane(agents[..., :2], scene),
    )
    known = scene.agent_mask & (classes != NO_KIND)
    return jnp.where(known, _kind(digits, agent_digits(codec)), NO_KIND)


def digits_of(kinds: Int[Array, "*n"], sizes: Sequence[int]) -> list[Int[Array, "*n"]]:
    """The digits of kinds, one array each."""
    steps = [math.prod(sizes[:place]) for place in range(len(sizes))]
    return [kinds // step % size for step, size in zip(steps, sizes, strict=True)]


def _kind(digits: Sequence[Array], sizes: Sequence[int]) -> Int[Array, "*n"]:
    """The first digit counts ones."""
    total, step = 0, 1
    for digit, size in zip(digits, sizes, strict=True):
        total, step = total + step * jnp.asarray(digit, jnp.int32), step * size
    return jnp.asarray(total)


def _quadrant(angle: Real[Array, "*n"]) -> Int[Array, "*n"]:
    """0: with the ego; 1: to its left; 2: against it; 3: to its right."""
    return jnp.round(angle / (np.pi / 2)).astype(jnp.int32) % 4


def _joints(ends: Real[Array, "*b lanes 2"], links: Int[Array, "*b lanes lanes"], crop: Int[Array, "*b"]):
    """0: none of these; 1: splits; 2: merges; 3: both; 4: ends inside the window."""
    after, before = (links == Link.PREDECESSOR).sum(-1), (links == Link.SUCCESSOR).sum(-1)
    middle = jnp.where(crop == Crop.FORWARD, TILE_SIZE / 2, 0.0)[..., None]
    reach = jnp.maximum(jnp.abs(ends[..., 0] - middle), jnp.abs(ends[..., 1]))
    ends_inside = (after == 0) & (reach < TILE_SIZE / 2 - _BORDER)
    return jnp.where(ends_inside, 4, (after > 1) + 2 * (before > 1))


def _is_on_lane(centers: Real[Array, "*b agents 2"], scene: Scene):
    lanes, lane_mask = jnp.asarray(scene.lanes)[..., :2], jnp.asarray(scene.lane_mask)
    offsets = centers[..., :, None, None, :] - lanes[..., None, :, :, :]
    near = ((offsets**2).sum(-1) < _ON_LANE**2) & lane_mask[..., None, :, None]
    return near.any((-2, -1))
