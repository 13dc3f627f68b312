"""What a scene offers to a staged event: its agents, places on its lanes, and what it costs to bring one to the other.

Of one scene, without batch axes; costs in m^2, so that the least one changes a scene least.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from scjax.scene import AgentType, AnyArray, Link, Scene

NEVER = 1e6  # m^2
TURN = 50.0  # m^2 that a quarter turn costs

_CROWDED = 60.0  # m^2 that somebody else in the place costs
_BLOCKED = 1000.0  # m^2 that somebody costs before whom none may be
_REACH = 21.0  # m from the ego within which events are staged
_JUNCTION = 19.5  # m from where lanes fork, merge or turn sharply
_BEND = 1 / 40  # rad/m of a sharp turn
_AHEAD = 15.0  # m that are free before who stands


class Poses(NamedTuple):
    """Where agents shall be: a rectangle's middle, half its length and width [m], its direction and theirs, slowest and
    fastest speed [m/s]; and which agents are meant."""

    place: Float[Array, "*b n 2"]
    room: Float[Array, "*b n 2"]
    ahead: Float[Array, "*b n 2"]
    slowest: Float[Array, "*b n"]
    fastest: Float[Array, "*b n"]
    meant: Bool[Array, "*b n"]


class Stage(NamedTuple):
    """Agents, and the points of all lanes with their directions.

    ``vehicle``, ``walker``: who may be led, never the ego. ``calm``: points far from junctions and within reach.
    """

    agents: Float[Array, "n 9"]
    someone: Bool[Array, " n"]
    vehicle: Bool[Array, " n"]
    walker: Bool[Array, " n"]
    points: Float[Array, "q 2"]
    ahead: Float[Array, "q 2"]
    there: Bool[Array, " q"]
    calm: Bool[Array, " q"]
    lanes: int


def look(scene: Scene, made: Bool[AnyArray, " n"]) -> Stage:
    """The stage that one scene is; ``made``: agents that may be led."""
    agents, types = jnp.asarray(scene.agents), jnp.asarray(scene.agent_types)
    line = jnp.asarray(scene.lanes)[..., :2]
    step = jnp.diff(line, axis=1)
    length = jnp.sqrt(jnp.square(step).sum(-1) + 1e-6)
    unit = step / length[..., None]
    mean = jnp.concatenate([unit[:, :1], unit[:, :-1] + unit[:, 1:], unit[:, -1:]], 1)
    ahead = mean / jnp.sqrt(jnp.square(mean).sum(-1, keepdims=True) + 1e-6)
    mask = jnp.asarray(scene.lane_mask)
    flows = (jnp.asarray(scene.links) == Link.PREDECESSOR) & mask[:, None] & mask[None]
    turn = jnp.abs(cross(unit[:, :-1], unit[:, 1:]))
    sharp = (turn > _BEND * length[:, :-1]) & (turn.sum(1, keepdims=True) > 0.6) & mask[:, None]
    spots = jnp.concatenate([line[:, -1], line[:, 0], line[:, 1:-1].reshape(-1, 2)])
    tight = jnp.concatenate([mask & (flows.sum(1) > 1), mask & (flows.sum(0) > 1), sharp.reshape(-1)])
    points, there = line.reshape(-1, 2), jnp.repeat(mask, line.shape[1])
    near = jnp.where(tight[None], squares(points, spots), NEVER).min(1)
    calm = there & (jnp.abs(points).max(-1) < _REACH) & (near > _JUNCTION**2)
    may = jnp.asarray(scene.agent_mask) & made & (jnp.arange(len(agents)) > 0)
    vehicle, walker = (may & (types == kind) for kind in (AgentType.VEHICLE, AgentType.PEDESTRIAN))
    someone = jnp.asarray(scene.agent_mask)
    return Stage(agents, someone, vehicle, walker, points, ahead.reshape(-1, 2), there, calm, len(line))


class Spot(NamedTuple):
    """Places where an agent may be, each a rectangle: its middle, its direction, half its length and width [m]."""

    place: Float[Array, "q 2"]
    ahead: Float[Array, "q 2"]
    free: Bool[Array, " q"]
    along: float
    aside: float


def change(stage: Stage, who: Bool[Array, " n"], spot: Spot, turn: float = TURN) -> Float[Array, "n q"]:
    """What it costs [m^2] to bring each of these agents to each place, and into the direction there."""
    along, aside = _seen_from(spot, stage.agents)
    off = jnp.square(jax.nn.relu(along - spot.along)) + jnp.square(jax.nn.relu(aside - spot.aside))
    turned = turn * (1 - stage.agents[:, 4:6] @ spot.ahead.T)
    return jnp.where(who[:, None] & spot.free[None], off + turned, NEVER)


def crowd(stage: Stage, spot: Spot, *, along: float = 5.0, aside: float = 5.0) -> Float[Array, "n q"]:
    """What the others cost who are nearer to a place than that [m]."""
    to = _seen_from(spot, stage.agents)
    near = (to[0] < along) & (to[1] < aside) & stage.someone[:, None]
    return _CROWDED * (near.sum(0)[None] - near)


def slow_down(stage: Stage) -> Float[Array, "n 1"]:
    """What it costs agents to stop."""
    return 2 * jnp.clip(stage.agents[:, 3], 0, 5)[:, None]


def blocked(stage: Stage, spot: Spot) -> Float[Array, " q"]:
    """What those cost who are in the lane before each place: whoever stands there would wait for them."""
    to = stage.agents[:, None, :2] - spot.place[None]
    along, aside = (to * spot.ahead[None]).sum(-1), jnp.abs(cross(spot.ahead[None], to))
    before = (along > 4.0) & (along < _AHEAD + 4.0) & (aside < 2.2) & stage.someone[:, None]
    view = jnp.abs(spot.place + _AHEAD * spot.ahead).max(-1) < 31.0
    return jnp.where(view, _BLOCKED * before.sum(0), NEVER)


def least(cost: Float[Array, "n q"]) -> tuple[Array, Array, Array]:
    """Agent and place of the least cost, and whether there is any."""
    who, where = jnp.unravel_index(cost.argmin(), cost.shape)
    return who, where, cost.min() < NEVER


def best_two(one: Float[Array, "n q"], other: Float[Array, "n q"]) -> tuple[Array, Array, Array, Array]:
    """Two different agents and a place, of the least cost together: the first one's by itself, the second one then."""
    first = one.argmin(0)
    rest = jnp.where(jnp.arange(len(one))[:, None] == first[None], NEVER, other)
    total = one.min(0) + rest.min(0)
    where = total.argmin()
    return first[where], rest[:, where].argmin(), where, total.min() < NEVER


def pose(
    stage: Stage, spot: Spot, who: Array, where: Array, good: Array, *, slowest: float = -1.0, fastest: float
) -> Poses:
    """One agent in a place."""
    meant = (jnp.arange(len(stage.agents)) == who) & good
    room, speeds = jnp.array([spot.along, spot.aside]), jnp.array([slowest, fastest])
    one = Poses(spot.place[where], room, spot.ahead[where], speeds[0], speeds[1], meant)
    none = nobody(stage.agents)
    return given_to(meant, jax.tree.map(lambda value, of_all: jnp.broadcast_to(value, of_all.shape), one, none), none)


def given_to(meant: Bool[Array, " n"], new: Poses, old: Poses) -> Poses:
    """The new parts for those who are meant, beside the old ones of the others."""

    def mixed(after: Array, before: Array) -> Array:
        return jnp.where(meant.reshape(-1, *[1] * (before.ndim - 1)), after, before)

    return jax.tree.map(mixed, new, old)._replace(meant=old.meant | meant)


def nobody(agents: Float[Array, "n 9"]) -> Poses:
    """Nobody has a part."""
    none = jnp.zeros(len(agents))
    return Poses(agents[:, :2], jnp.zeros((len(agents), 2)), agents[:, 4:6], none, none, none > 0)


def beside(stage: Stage, off: float) -> Float[Array, "places 2"]:
    """Points so far to the right of all lanes, and then those to their left [m]."""
    return jnp.concatenate([stage.points - off * left_of(stage.ahead), stage.points + off * left_of(stage.ahead)])


def twice(x: Array) -> Array:
    """For the points of ``beside``."""
    return jnp.concatenate([x, x])


def _seen_from(spot: Spot, agents: Float[Array, "n 9"]) -> tuple[Float[Array, "n q"], Float[Array, "n q"]]:
    """How far agents are before or behind places, and beside them [m]."""
    along, aside = (
        jnp.abs(agents[:, :2] @ axis.T - (spot.place * axis).sum(-1)[None])
        for axis in (spot.ahead, left_of(spot.ahead))
    )  # fmt: skip
    return along, aside


def left_of(ahead: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
    """Directions a quarter turn to the left."""
    return jnp.stack([-ahead[..., 1], ahead[..., 0]], -1)


def cross(a: Float[Array, "*#n 2"], b: Float[Array, "*#n 2"]) -> Float[Array, "*n"]:
    """z of the cross product: how far b is to the left of a."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def squares(a: Float[Array, "n 2"], b: Float[Array, "m 2"]) -> Float[Array, "n m"]:
    """Squared distances [m^2]; by a product, as there are many."""
    return jnp.square(a).sum(-1)[:, None] + jnp.square(b).sum(-1)[None] - 2 * a @ b.T
