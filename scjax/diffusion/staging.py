"""Staging: the rare events that are asked for, as poses to which the agents that shall make them are led.

A network that has seen few of them gets an event nearly right: a pedestrian stops short of the lane, a queue keeps its
half metre from the middle on the wrong side. So on the lanes of an estimate a place is looked for where the event can
happen, with the agents that have least to change; ``steering`` then leads these agents there, while the network goes on
to answer with the rest. What an event needs is what ``captions.events`` reads, with some room. Not in the paper.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from scjax.data.captions.events import Event
from scjax.diffusion.steering import Steering
from scjax.scene import AgentType, Link, Scene

EVENTS: tuple[Event, ...] = get_args(Event)
STAGING = Steering(rounds=32, below=0.7, lanes=0.0)
"""How agents are led: from a noise at which an agent can still turn round, and no lane is moved."""

_TURN = 50.0  # m^2 that half a turn costs, twice over
_PULL = 400.0  # m^2, of an agent's direction
_PACE = 2.0  # s^2
_WIDE = 8.0  # m; beyond that the pull grows no further
_CROWDED = 60.0  # m^2 that somebody else in the place costs
_NEVER = 1e6  # m^2
_REACH = 21.0  # m from the ego within which events are staged
_JUNCTION = 19.5  # m from where lanes fork, merge or turn sharply
_BEND = 1 / 40  # rad/m of a sharp turn
_QUEUED = 1.6**2  # m^2 off a lane of who queues there
_AHEAD = 15.0  # m that are free before who stands
_LEAN = 0.18  # rad towards the lane into which one cuts


class Poses(NamedTuple):
    """Where agents shall be: place [m], direction, slowest and fastest speed [m/s]; and which agents are meant."""

    place: Float[Array, "n 2"]
    ahead: Float[Array, "n 2"]
    slowest: Float[Array, " n"]
    fastest: Float[Array, " n"]
    meant: Bool[Array, " n"]


class _Stage(NamedTuple):
    """What one scene offers: its agents, and the points of its lanes with their directions.

    ``calm``: far from junctions and within reach. ``vehicle``, ``walker``: who may be led, never the ego.
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

    @property
    def left(self) -> Float[Array, "q 2"]:
        return _left(self.ahead)


def stage(scene: Scene, asked: Bool[Array, "b events"], made: Bool[Array, "b n"]) -> Poses:
    """Poses [B, ...] that make the events asked for happen in each scene; nobody is meant where there is no room.

    Args:
      asked: which of ``EVENTS``.
      made: agents that may be led.
    """
    return jax.vmap(_staged)(scene, asked, made)


def energy(scene: Scene, poses: Poses) -> Float[Array, " b"]:
    """Half the squared distance from the poses [m^2], a turn and a speed counted as metres; summed over who is meant."""
    agents = jnp.asarray(scene.agents)
    off = jnp.square(agents[..., :2] - poses.place).sum(-1)
    turned = jnp.square(agents[..., 4:6] - _nearer(poses.ahead, agents[..., 4:6])).sum(-1)
    pace = jnp.square(jax.nn.relu(poses.slowest - agents[..., 3]) + jax.nn.relu(agents[..., 3] - poses.fastest))
    away = _WIDE**2 * (jnp.sqrt(1 + off / _WIDE**2) - 1) + 0.5 * (_PULL * turned + _PACE * pace)
    return jnp.where(poses.meant, away, 0).sum(-1)


def _nearer(wanted: Float[Array, "*b n 2"], ahead: Float[Array, "*b n 2"]) -> Float[Array, "*b n 2"]:
    """A direction, or a right angle towards it where it is further: nothing pulls who faces the other way round."""
    ahead = jax.lax.stop_gradient(ahead)
    side = jnp.where(_cross(ahead, wanted) < 0, -1.0, 1.0)[..., None] * _left(ahead)
    return jnp.where((ahead * wanted).sum(-1, keepdims=True) < 0, side, wanted)


def told(events: Sequence[Sequence[str]]) -> Bool[np.ndarray, "b events"]:
    """Names of events, those of a scene each -> which of ``EVENTS``."""
    return np.array([[event in names for event in EVENTS] for names in events], bool)


def _staged(scene: Scene, asked: Bool[Array, " events"], made: Bool[Array, " n"]) -> Poses:
    stage = _look(scene, made)
    poses = _nobody(stage.agents)
    for number, event in enumerate(EVENTS):
        found = _ACTS[event](stage)
        taken = found.meant & asked[number] & ~poses.meant  # who has a part keeps it
        poses = Poses(*(_where(taken, new, old) for new, old in zip(found, poses, strict=True)))
        poses = poses._replace(meant=poses.meant | taken)
    return poses


def _look(scene: Scene, made: Bool[Array, " n"]) -> _Stage:
    agents, types = jnp.asarray(scene.agents), jnp.asarray(scene.agent_types)
    line = jnp.asarray(scene.lanes)[..., :2]
    step = jnp.diff(line, axis=1)
    length = jnp.sqrt(jnp.square(step).sum(-1) + 1e-6)
    unit = step / length[..., None]
    mean = jnp.concatenate([unit[:, :1], unit[:, :-1] + unit[:, 1:], unit[:, -1:]], 1)
    ahead = mean / jnp.sqrt(jnp.square(mean).sum(-1, keepdims=True) + 1e-6)
    mask = jnp.asarray(scene.lane_mask)
    flows = (jnp.asarray(scene.links) == Link.PREDECESSOR) & mask[:, None] & mask[None]
    turn = jnp.abs(_cross(unit[:, :-1], unit[:, 1:]))
    sharp = (turn > _BEND * length[:, :-1]) & (turn.sum(1, keepdims=True) > 0.6) & mask[:, None]
    spots = jnp.concatenate([line[:, -1], line[:, 0], line[:, 1:-1].reshape(-1, 2)])
    tight = jnp.concatenate([mask & (flows.sum(1) > 1), mask & (flows.sum(0) > 1), sharp.reshape(-1)])
    points, there = line.reshape(-1, 2), jnp.repeat(mask, line.shape[1])
    near = jnp.where(tight[None], _squares(points, spots), _NEVER).min(1)
    calm = there & (jnp.abs(points).max(-1) < _REACH) & (near > _JUNCTION**2)
    may = jnp.asarray(scene.agent_mask) & made & (jnp.arange(len(agents)) > 0)
    return _Stage(
        agents, jnp.asarray(scene.agent_mask), may & (types == AgentType.VEHICLE), may & (types == AgentType.PEDESTRIAN),
        points, ahead.reshape(-1, 2), there, calm, len(line),
    )  # fmt: skip


def _wrong_way(stage: _Stage) -> Poses:
    spot = _Spot(stage.points, -stage.ahead, stage.calm, along=2.0, aside=0.6)
    who, where, good = _least(_change(stage, stage.vehicle, spot) + _crowd(stage, spot))
    return _pose(stage, spot, who, where, good, slowest=4.0, fastest=12.0)


def _jaywalker(stage: _Stage) -> Poses:
    spot = _Spot(stage.points, stage.ahead, stage.calm, along=2.0, aside=1.0)
    who, where, good = _least(_change(stage, stage.walker, spot, turn=0.0) + _crowd(stage, spot))
    poses = _pose(stage, spot, who, where, good, slowest=1.0, fastest=2.2)
    across = stage.left[where]
    across = across * jnp.where((stage.agents[who, 4:6] * across).sum() < 0, -1.0, 1.0)
    return poses._replace(ahead=_where(poses.meant, across, poses.ahead))


def _stopped(stage: _Stage) -> Poses:
    spot = _Spot(stage.points, stage.ahead, stage.calm, along=2.0, aside=0.5)
    cost = _change(stage, stage.vehicle, spot) + _crowd(stage, spot) + _blocked(stage)[None]
    who, where, good = _least(cost + _faster(stage, 0.0))
    return _pose(stage, spot, who, where, good, fastest=-0.3)


def _double_parking(stage: _Stage) -> Poses:
    """One stands at the edge of an outer lane, another beside it at the kerb."""
    edge, kerb = (_beside(stage, off) for off in (0.8, 3.4))  # both sides of every lane
    free = ~((_squares(kerb, stage.points) < 2.4**2) & stage.there[None]).any(1)
    ahead, calm = _twice(stage.ahead), _twice(stage.calm) & free
    one, other = _Spot(edge, ahead, calm, along=2.0, aside=0.15), _Spot(kerb, ahead, calm, along=3.0, aside=0.4)
    stands = _faster(stage, 0.0)
    cost = _change(stage, stage.vehicle, one) + _crowd(stage, one) + _twice(_blocked(stage))[None] + stands
    who, whom, where, good = _two(cost, _change(stage, stage.vehicle, other) + stands)
    doubled = _pose(stage, one, who, where, good, fastest=-0.3)
    return _also(doubled, _pose(stage, other, whom, where, good, fastest=-0.3))


def _cut_in(stage: _Stage) -> Poses:
    """One leaves the lane beside for the lane of another, shortly before it."""
    along = _twice(stage.ahead @ stage.ahead.T > 0.95)
    lane = (_squares(_beside(stage, 3.5), stage.points) < 1.9**2) & along & stage.there[None]
    side = jnp.repeat(jnp.array([-1.0, 1.0]), len(stage.points))[:, None]
    ahead, calm = _twice(stage.ahead), _twice(stage.calm) & lane.any(1)
    leaning = (ahead - _LEAN * side * _left(ahead)) / np.hypot(1, _LEAN)
    behind = _twice(stage.points - 11.0 * stage.ahead)
    one = _Spot(_beside(stage, 1.3), leaning, calm, along=2.0, aside=0.4)
    other = _Spot(behind, ahead, calm & (jnp.abs(behind).max(-1) < 29.0), along=3.0, aside=0.5)
    slow = 2 * jax.nn.relu(4.0 - stage.agents[:, 3])[:, None]
    cost = _change(stage, stage.vehicle, one) + _crowd(stage, one) + slow
    who, whom, where, good = _two(cost, _change(stage, stage.vehicle, other) + slow)
    cutting = _pose(stage, one, who, where, good, slowest=4.0, fastest=15.0)
    return _also(cutting, _pose(stage, other, whom, where, good, slowest=3.0, fastest=15.0))


def _corridor(stage: _Stage) -> Poses:
    """Those of two lanes side by side stand at their outer edges: left lane to the left, right lane to the right."""
    agents, lanes = stage.agents, stage.lanes
    points, ahead = (x.reshape(lanes, -1, 2) for x in (stage.points, stage.ahead))
    apart = _squares(agents[:, :2], stage.points).reshape(len(agents), lanes, -1)
    nearest = apart.argmin(2)  # of every agent on every lane
    rows = jnp.arange(lanes)[None]
    foot, way = points[rows, nearest], ahead[rows, nearest]  # [n, lanes, xy]
    to = agents[:, None, :2] - foot
    along, left = (to * way).sum(-1), _cross(way, to)
    unlike = 1 - (agents[:, None, 4:6] * way).sum(-1)
    there = stage.there.reshape(lanes, -1)[:, 0]
    cost = jnp.square(left) + jnp.square(jax.nn.relu(jnp.abs(along) - 2)) + _TURN * unlike
    cost = cost + jnp.where(agents[:, None, 3] > 3.5, 6.0, 0.0)
    cost = jnp.where(stage.vehicle[:, None] & there[None], cost, _NEVER)
    queued = cost < _QUEUED
    middle, heading = points[:, points.shape[1] // 2], ahead[:, points.shape[1] // 2]
    across = middle[None, :] - middle[:, None]
    aside = _cross(heading[:, None], across)
    parallel = (heading @ heading.T > 0.95) & (jnp.abs((across * heading[:, None]).sum(-1)) < 25.0)
    beside = parallel & (aside < -2.4) & (aside > -4.6) & there[:, None] & there[None]
    number = queued.sum(0)
    enough = jnp.minimum(number, 2)
    merit = 100.0 * (enough[:, None] + enough[None]) + (number[:, None] + number[None])
    merit = jnp.where(beside, merit, -1.0)
    one, other = jnp.unravel_index(merit.argmax(), merit.shape)
    good = merit.max() >= 0
    row, pair = jnp.arange(len(agents)), jnp.stack([one, other])
    costs, inward = cost[:, pair], left[:, pair] * jnp.array([-1.0, 1.0])
    between = inward > 0.8  # of the two queues, in the way that they leave
    proper = (costs < _QUEUED) & ~between & (costs.argmin(1)[:, None] == jnp.arange(2)[None])
    wanted = costs - _NEVER * proper
    right = wanted[:, 1].argsort().argsort() < 2  # two each, at least
    first = jnp.where(right, 2 * _NEVER, wanted[:, 0]).argsort().argsort() < 2
    side = jnp.where(right, 1, jnp.where(first, 0, costs.argmin(1)))
    meant = stage.vehicle & good & (right | first | (costs[row, side] < _QUEUED))
    lane, aside = pair[side], jnp.where(between[row, side] & ~right & ~first, 1.8, -0.8)
    foot, way = foot[row, lane], way[row, lane]
    kept = jnp.clip(along[row, lane], -2, 2)[:, None] * way
    place = foot + kept + (aside * jnp.where(side == 0, -1.0, 1.0))[:, None] * _left(way)
    still = jnp.zeros(len(agents))
    return Poses(place, way, still - 1.0, still + 1.5, meant)


_ACTS: dict[Event, Callable[[_Stage], Poses]] = {
    "wrong-way driver": _wrong_way, "jaywalker": _jaywalker, "stopped vehicle in lane": _stopped,
    "double parking": _double_parking, "emergency corridor": _corridor, "cut-in": _cut_in,
}  # fmt: skip


class _Spot(NamedTuple):
    """Places where an agent may be, each a rectangle: its middle, its direction, half its length and width [m]."""

    place: Float[Array, "q 2"]
    ahead: Float[Array, "q 2"]
    free: Bool[Array, " q"]
    along: float
    aside: float


def _change(stage: _Stage, who: Bool[Array, " n"], spot: _Spot, turn: float = _TURN) -> Float[Array, "n q"]:
    """What it costs [m^2] to bring each of these agents to each place, and into the direction there."""
    there = stage.agents[:, :2]
    along, aside = (
        there @ axis.T - (spot.place * axis).sum(-1)[None] for axis in (spot.ahead, _left(spot.ahead))
    )  # fmt: skip
    off = jnp.square(jax.nn.relu(jnp.abs(along) - spot.along)) + jnp.square(jax.nn.relu(jnp.abs(aside) - spot.aside))
    turned = turn * (1 - stage.agents[:, 4:6] @ spot.ahead.T)
    return jnp.where(who[:, None] & spot.free[None], off + turned, _NEVER)


def _crowd(stage: _Stage, spot: _Spot) -> Float[Array, "n q"]:
    """What the others in a place cost."""
    near = (_squares(stage.agents[:, :2], spot.place) < 5.0**2) & stage.someone[:, None]
    return _CROWDED * (near.sum(0)[None] - near)


def _faster(stage: _Stage, speed: float) -> Float[Array, "n 1"]:
    """What it costs agents to slow down."""
    return 2 * jnp.clip(stage.agents[:, 3] - speed, 0, 5)[:, None]


def _blocked(stage: _Stage) -> Float[Array, " q"]:
    """What those cost who are in the lane before each point: whoever stands there would wait for them."""
    along = stage.agents[:, :2] @ stage.ahead.T - (stage.points * stage.ahead).sum(-1)[None]
    left = stage.agents[:, :2] @ stage.left.T - (stage.points * stage.left).sum(-1)[None]
    before = (along > 4.0) & (along < _AHEAD + 4.0) & (jnp.abs(left) < 2.2) & stage.someone[:, None]
    view = jnp.abs(stage.points + _AHEAD * stage.ahead).max(-1) < 31.0
    return jnp.where(view, _CROWDED * before.sum(0), _NEVER)


def _least(cost: Float[Array, "n q"]) -> tuple[Array, Array, Array]:
    """Agent and place of the least cost, and whether there is any."""
    who, where = jnp.unravel_index(cost.argmin(), cost.shape)
    return who, where, cost.min() < _NEVER


def _two(one: Float[Array, "n q"], other: Float[Array, "n q"]) -> tuple[Array, Array, Array, Array]:
    """Two different agents and a place, of the least cost together: the first one's by itself, the second one then."""
    first = one.argmin(0)
    rest = jnp.where(jnp.arange(len(one))[:, None] == first[None], _NEVER, other)
    total = one.min(0) + rest.min(0)
    where = total.argmin()
    return first[where], rest[:, where].argmin(), where, total.min() < _NEVER


def _pose(
    stage: _Stage, spot: _Spot, who: Array, where: Array, good: Array, *, slowest: float = -1.0, fastest: float
) -> Poses:
    """One agent in the nearest part of a place."""
    place, ahead = spot.place[where], spot.ahead[where]
    to, left = stage.agents[who, :2] - place, _left(spot.ahead[where])
    along, aside = jnp.clip((to * ahead).sum(), -spot.along, spot.along), (to * left).sum()
    place = place + along * ahead + jnp.clip(aside, -spot.aside, spot.aside) * left
    poses, meant = _nobody(stage.agents), (jnp.arange(len(stage.agents)) == who) & good
    values = place, ahead, jnp.float32(slowest), jnp.float32(fastest)
    return Poses(*(_where(meant, new, old) for new, old in zip(values, poses[:4], strict=True)), meant)


def _also(one: Poses, other: Poses) -> Poses:
    poses = Poses(*(_where(other.meant, new, old) for new, old in zip(other, one, strict=True)))
    return poses._replace(meant=one.meant | other.meant)


def _nobody(agents: Float[Array, "n 9"]) -> Poses:
    none = jnp.zeros(len(agents))
    return Poses(agents[:, :2], agents[:, 4:6], none, none, none > 0)


def _where(meant: Bool[Array, " n"], new, old: Array) -> Array:
    return jnp.where(meant.reshape(-1, *[1] * (old.ndim - 1)), new, old)


def _beside(stage: _Stage, off: float) -> Float[Array, "2q 2"]:
    """Points so far to the right of all lanes, and then those to their left [m]."""
    return jnp.concatenate([stage.points - off * stage.left, stage.points + off * stage.left])


def _twice(x: Array) -> Array:
    return jnp.concatenate([x, x])


def _left(ahead: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
    return jnp.stack([-ahead[..., 1], ahead[..., 0]], -1)


def _cross(a: Float[Array, "*n 2"], b: Float[Array, "*n 2"]) -> Float[Array, "*n"]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _squares(a: Float[Array, "n 2"], b: Float[Array, "m 2"]) -> Float[Array, "n m"]:
    """Squared distances [m^2]; by a product, as there are many."""
    return jnp.square(a).sum(-1)[:, None] + jnp.square(b).sum(-1)[None] - 2 * a @ b.T
