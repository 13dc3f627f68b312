"""Agents and ways -> the numbers that the behavior network reads. All are relative to the agent: no frame matters.

x and y stay separate arrays: a trailing axis of two would make the searches over all pairs many times slower.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from scjax.models.behavior.config import STEP, BehaviorConfig
from scjax.models.behavior.traffic import FAR, WAY, Traffic
from scjax.scene import AgentType, Signal
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray

_DISCOUNT = 0.2  # of the distance along the way, in the choice of neighbors
_SIDE_ROOM = 0.3  # m beside a vehicle; who is nearer to its way is in it
_CROSSING_POINTS = 16  # of the ways, at which they are compared
_CROSSING = 2.6  # m between ways that cross
_COMFORT = 1.5  # m/s^2 before bends


@pytree
class Surroundings(Replaceable):
    """What M agents see.

    Attributes:
      own: features of the agent, its history, its way and its leader.
      others: features of its K neighbors.
      mask: which of them are there.
      near: their rows.
      lead_gap, lead_speed: to the next body in the way from bumper to bumper [m], and its speed along the way [m/s].
    """

    own: Float[AnyArray, "*b M F"]
    others: Float[AnyArray, "*b M K G"]
    mask: Bool[AnyArray, "*b M K"]
    near: Int[AnyArray, "*b M K"]
    lead_gap: Float[AnyArray, "*b M"]
    lead_speed: Float[AnyArray, "*b M"]


class _Pairs(NamedTuple):
    """Agents [N] as M agents see them along their own ways: distance ahead, to the left, and direction of the way."""

    along: Array
    left: Array
    tangent_x: Array
    tangent_y: Array
    nearness: Array


def surroundings_of(traffic: Traffic, rows: Int[AnyArray, " M"] | None, neighbors: int) -> Surroundings:
    """What agents of one scene see.

    Args:
      rows: of the agents, or None for all.
      neighbors: K, at most the number of agents.
    """
    traffic = jax.tree.map(jnp.asarray, traffic)
    own = traffic if rows is None else traffic.take(rows)
    numbers = jnp.arange(traffic.x.shape[0]) if rows is None else jnp.asarray(rows)
    pairs = _along_way(own, traffic)
    there = jnp.asarray(traffic.valid)[None] & (jnp.arange(traffic.x.shape[0])[None] != numbers[:, None])
    gap, speed = _leader(own, traffic, pairs, there)
    _, near = jax.lax.top_k(jnp.where(there, -pairs.nearness, -jnp.inf), neighbors)
    mask = jnp.take_along_axis(there, near, axis=1)
    features = _own_features(own, gap, speed)
    others = _other_features(own, traffic.take(near), pairs, near)
    others = jnp.where(mask[..., None], others, 0.0)
    return Surroundings(own=features, others=others, mask=mask, near=near, lead_gap=gap, lead_speed=speed)


@functools.lru_cache(maxsize=8)
def feature_sizes(history: int) -> tuple[int, int]:
    """Numbers of features of an agent and of a neighbor."""
    traffic = empty_traffic(2, history)
    seen = jax.eval_shape(lambda one: surroundings_of(one, None, 1), traffic)
    return seen.own.shape[-1], seen.others.shape[-1]


def empty_traffic(agents: int, history: int) -> Traffic:
    """Traffic of agents that are not there."""
    one, way = jnp.zeros(agents), jnp.zeros((agents, len(WAY)))
    whole, no = jnp.zeros(agents, jnp.int32), jnp.zeros(agents, bool)
    motions = jnp.zeros((agents, history, 3))
    return Traffic(
        x=one, y=one, heading=one, length=one + 1, width=one + 1, kind=whole, valid=no, motions=motions,
        known=jnp.zeros((agents, history), bool), way_x=way, way_y=way, limit=way, inside=way > 0, has_way=no,
        signal=whole, signal_gap=one + FAR, end_gap=one + FAR,
    )  # fmt: skip


def sizes_of(config: BehaviorConfig) -> tuple[int, int]:
    """``feature_sizes`` of a config."""
    return feature_sizes(config.history)


def _tangents(traffic: Traffic) -> tuple[Array, Array]:
    """Unit vectors along the ways [N, W]."""
    d_x, d_y = jnp.diff(traffic.way_x, axis=-1), jnp.diff(traffic.way_y, axis=-1)
    norm = jnp.sqrt(jnp.maximum(d_x * d_x + d_y * d_y, 1e-8))
    # Points behind the end of a way coincide: the last direction goes on.
    moves = norm > 0.05
    t_x, t_y = jnp.where(moves, d_x / norm, 0.0), jnp.where(moves, d_y / norm, 0.0)
    last = jnp.maximum(moves.sum(-1, keepdims=True) - 1, 0)
    t_x = jnp.where(moves, t_x, jnp.take_along_axis(t_x, last, axis=-1))
    t_y = jnp.where(moves, t_y, jnp.take_along_axis(t_y, last, axis=-1))
    return jnp.concatenate([t_x, t_x[..., -1:]], -1), jnp.concatenate([t_y, t_y[..., -1:]], -1)


def _along_way(own: Traffic, traffic: Traffic) -> _Pairs:
    """All agents [N] along the ways of M agents."""
    apart_x = traffic.x[None, :, None] - own.way_x[:, None]
    apart_y = traffic.y[None, :, None] - own.way_y[:, None]
    square = apart_x * apart_x + apart_y * apart_y
    square = jnp.where(own.inside[:, None], square, square + 1e4)
    nearness = (jnp.sqrt(square) + _DISCOUNT * jnp.asarray(WAY)[None, None]).min(-1)
    point = jnp.argmin(square, axis=-1)
    t_x, t_y = _tangents(own)
    t_x, t_y, p_x, p_y = (jnp.take_along_axis(v, point, axis=1) for v in (t_x, t_y, own.way_x, own.way_y))
    d_x, d_y = traffic.x[None] - p_x, traffic.y[None] - p_y
    along = jnp.asarray(WAY)[point] + d_x * t_x + d_y * t_y
    return _Pairs(along, jnp.asarray(d_y * t_x - d_x * t_y), t_x, t_y, nearness)


def _leader(own: Traffic, traffic: Traffic, pairs: _Pairs, there: Array) -> tuple[Array, Array]:
    """Gap to the next body in the way of each agent [m] and its speed along the way [m/s]."""
    cos, sin = jnp.cos(traffic.heading)[None], jnp.sin(traffic.heading)[None]
    forward = jnp.abs(cos * pairs.tangent_x + sin * pairs.tangent_y)
    across = jnp.abs(sin * pairs.tangent_x - cos * pairs.tangent_y)
    half_length, half_width = 0.5 * traffic.length[None], 0.5 * traffic.width[None]
    reach = half_length * forward + half_width * across
    room = half_length * across + half_width * forward + 0.5 * own.width[:, None] + _SIDE_ROOM
    ahead = there & (jnp.abs(pairs.left) < room) & (pairs.along > 0.0)
    gap = jnp.where(ahead, pairs.along - reach - 0.5 * own.length[:, None], FAR)
    row = jnp.argmin(gap, axis=1)[:, None]
    speed = traffic.motions[:, 0, 0] / STEP
    along = (traffic.heading[row], pairs.tangent_x, pairs.tangent_y)
    t_x, t_y = (jnp.take_along_axis(value, row, axis=1) for value in along[1:])
    speed = speed[row] * (jnp.cos(along[0]) * t_x + jnp.sin(along[0]) * t_y)
    gap = jnp.take_along_axis(gap, row, axis=1)[:, 0]
    return gap, jnp.where(gap < 0.5 * FAR, speed[:, 0], 0.0)


def _soft(value: Any, scale: float) -> Array:
    """Any number as one between -1 and 1, steepest at 0."""
    return value / (scale + jnp.abs(value))


def _gap(value: Any) -> list[Array]:
    """A distance at three scales."""
    return [_soft(value, 1.0), _soft(value, 5.0), _soft(value, 25.0)]


def _kinds(kind: Any) -> list[Array]:
    return [(kind == number).astype(jnp.float32) for number in range(len(AgentType))]


def _own_features(own: Traffic, gap: Array, lead_speed: Array) -> Array:
    """Features of M agents themselves."""
    speed = own.motions[:, 0, 0] / STEP
    known = own.known.astype(jnp.float32)
    changes = own.motions[:, 1:] - own.motions[:, :1]
    changes = changes * known[:, 1:, None]
    t_x, t_y = _tangents(own)
    cos, sin = jnp.cos(own.heading)[:, None], jnp.sin(own.heading)[:, None]
    d_x, d_y = own.way_x - own.x[:, None], own.way_y - own.y[:, None]
    ahead, left = d_x * cos + d_y * sin, d_y * cos - d_x * sin
    turn = t_y * cos - t_x * sin
    inside = own.inside.astype(jnp.float32)
    comfort = jnp.sqrt(own.limit * own.limit + 2 * _COMFORT * jnp.asarray(WAY)[None])
    limit = jnp.where(own.inside, comfort, 60.0).min(1)
    has_way = own.has_way.astype(jnp.float32)
    lateral = -left[:, 0] * has_way
    closing = jnp.maximum(speed - lead_speed, 0.0)
    needed = closing * closing / (2 * jnp.maximum(gap, 0.3))
    stop = speed * speed / (2 * jnp.maximum(own.signal_gap - 0.5 * own.length, 0.3))
    signals = [(own.signal == state).astype(jnp.float32) for state in Signal]
    columns = [
        speed / 10.0, jnp.tanh(speed), 5 * own.motions[:, 0, 1], 10 * own.motions[:, 0, 2], known[:, 0],
        own.length / 5, own.width / 2, *_kinds(own.kind), has_way, lateral, _soft(lateral, 0.3),
        3 * turn[:, 0] * has_way,
        limit / 15, jnp.tanh((limit - speed) / 3), own.limit[:, 0] / 15,
        *_gap(gap), jnp.tanh((lead_speed - speed) / 3), lead_speed / 10, jnp.minimum(needed / 5, 2.0),
        *signals, *_gap(own.signal_gap), jnp.minimum(stop / 5, 2.0), *_gap(own.end_gap),
    ]  # fmt: skip
    blocks = [
        (changes * jnp.array([[[2.0, 10.0, 20.0]]])).reshape(len(speed), -1),
        known[:, 1:],
        0.05 * ahead * inside,
        left * inside / (2.0 + 0.2 * jnp.asarray(WAY)[None]),
        2 * turn * inside,
        own.limit * inside / 15,
        inside,
    ]
    return jnp.concatenate([jnp.stack(columns, -1), *blocks], -1)


def _other_features(own: Traffic, other: Traffic, pairs: _Pairs, near: Array) -> Array:
    """Features of the neighbors of M agents [M, K, G]."""
    cos, sin = jnp.cos(own.heading)[:, None], jnp.sin(own.heading)[:, None]
    d_x, d_y = other.x - own.x[:, None], other.y - own.y[:, None]
    ahead, left = d_x * cos + d_y * sin, d_y * cos - d_x * sin
    o_cos, o_sin = jnp.cos(other.heading), jnp.sin(other.heading)
    r_cos, r_sin = o_cos * cos + o_sin * sin, o_sin * cos - o_cos * sin
    speed, own_speed = other.motions[..., 0, 0] / STEP, own.motions[:, 0, 0, None] / STEP
    change = jnp.where(other.known[..., 1], other.motions[..., 0, 0] - other.motions[..., 1, 0], 0.0)
    along, side = (jnp.take_along_axis(value, near, axis=1) for value in (pairs.along, pairs.left))
    # The agent along the ways of its neighbors.
    back_x, back_y = own.x[:, None, None] - other.way_x, own.y[:, None, None] - other.way_y
    square = jnp.where(other.inside, back_x * back_x + back_y * back_y, 1e6)
    point = jnp.argmin(square, axis=-1, keepdims=True)
    back = jnp.asarray(WAY)[point[..., 0]]
    back_side = jnp.sqrt(jnp.take_along_axis(square, point, axis=-1)[..., 0])
    crosses, own_rest, its_rest = _crossings(own, other)
    clearance = jnp.sqrt(d_x * d_x + d_y * d_y + 1e-6)
    when = own_rest / jnp.maximum(own_speed, 1.0) - its_rest / jnp.maximum(speed, 1.0)
    cross = crosses.astype(jnp.float32)
    stops = (other.signal == Signal.STOP).astype(jnp.float32) * _soft(other.signal_gap, 10.0)
    columns = [
        ahead / 30, left / 30, _soft(ahead, 3.0), _soft(left, 3.0), r_cos, r_sin,
        speed * r_cos / 10, speed * r_sin / 10, (speed * r_cos - own_speed) / 10, jnp.tanh(speed),
        5 * change, 10 * other.motions[..., 0, 2],
        other.length / 5, other.width / 2, *_kinds(other.kind), _soft(clearance, 3.0),
        *_gap(along), _soft(side, 1.0), _soft(side, 5.0), _soft(back, 5.0), _soft(back_side, 2.0),
        cross, *(cross * value for value in _gap(own_rest)), *(cross * value for value in _gap(its_rest)),
        cross * jnp.tanh(when / 2), cross * jnp.tanh(when / 6), other.has_way.astype(jnp.float32), stops,
    ]  # fmt: skip
    return jnp.stack(columns, -1)


def _crossings(own: Traffic, other: Traffic) -> tuple[Array, Array, Array]:
    """Whether the ways of an agent and of a neighbor meet, and how far each of them is from there [m]."""
    n = _CROSSING_POINTS
    d_x = own.way_x[:, None, :n, None] - other.way_x[:, :, None, :n]
    d_y = own.way_y[:, None, :n, None] - other.way_y[:, :, None, :n]
    hit = d_x * d_x + d_y * d_y < _CROSSING**2
    hit = hit & own.inside[:, None, :n, None] & other.inside[:, :, None, :n]
    rows, columns = hit.any(-1), hit.any(-2)
    distances = jnp.asarray(WAY)
    return jnp.any(rows, -1), distances[jnp.argmax(rows, -1)], distances[jnp.argmax(columns, -1)]
