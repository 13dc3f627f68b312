"""The emergency corridor: traffic of two lanes side by side that keeps to its outer edges, and leaves a way between.

Of one scene, without batch axes; see ``acts``.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from scjax.diffusion.staging.spots import NEVER, TURN, Poses, Stage, cross, left_of, squares

_OUT = 0.7  # m off the middle of a lane, where one keeps to its outer edge
_ROOM = (4.0, 0.3)  # m along and across, to give way to others
_ABREAST = 5.5  # m along in which two of a lane are abreast
_QUEUED = 1.6**2  # m^2 that it costs at most who already queues in a lane
_APART = (2.4, 4.6)  # m between the middles of lanes side by side
_FASTER = (3.5, 6.0)  # m/s; m^2 that it costs who is faster to queue
_STANDS, _THROUGH = (-1.0, 1.5), (5.0, 9.0)  # m/s, slowest and fastest: of who queues, and of who drives between


class _InLanes(NamedTuple):
    """Every agent in every lane: nearest point and direction there, how far beyond and to its left; what it costs."""

    foot: Float[Array, "n lanes 2"]
    ahead: Float[Array, "n lanes 2"]
    along: Float[Array, "n lanes"]
    left: Float[Array, "n lanes"]
    cost: Float[Array, "n lanes"]


def corridor(stage: Stage) -> Poses:
    """The two lanes that have most traffic already; each gets two vehicles at least.

    Who is between them, or abreast of the ego or of one further out in the same lane, drives on through the corridor.
    """
    seen = _in_lanes(stage)
    pair, good = _pair(stage, seen.cost < _QUEUED)
    cost, row = seen.cost[:, pair], jnp.arange(len(stage.agents))
    side = cost.argmin(1)
    inward = jnp.where(side == 0, -1.0, 1.0) * seen.left[row, pair[side]]
    inward = inward.at[0].set(-jnp.inf)  # the ego stays where it is
    queued = (cost[row, side] < _QUEUED) | (row == 0)
    along = _along(stage, seen.ahead[row, pair[side]])
    abreast = (along < _ABREAST) & queued[None] & (side[:, None] == side[None]) & (inward[None] < inward[:, None])
    through = queued & ((inward > _OUT) | abreast.any(1))
    cheap = cost - NEVER * ((queued & ~through)[:, None] & (side[:, None] == jnp.arange(2)[None]))
    cheap = cheap.at[0].set(2 * NEVER)
    right = cheap[:, 1].argsort().argsort() < 2
    left = jnp.where(right, 2 * NEVER, cheap[:, 0]).argsort().argsort() < 2
    side, through = jnp.where(right, 1, jnp.where(left, 0, side)), through & ~right & ~left
    lane = pair[side]
    foot, ahead = seen.foot[row, lane], seen.ahead[row, lane]
    outward = jnp.where(side == 0, _OUT, -_OUT)[:, None] * left_of(ahead)
    place = foot + jnp.clip(seen.along[row, lane], -2, 2)[:, None] * ahead + outward
    room = jnp.where(through[:, None], jnp.inf, jnp.array(_ROOM)[None])
    slowest, fastest = (jnp.where(through, *pace) for pace in zip(_THROUGH, _STANDS, strict=True))
    meant = stage.vehicle & good & (right | left | queued) & (cost[row, side] < NEVER)
    return Poses(place, room, ahead, slowest, fastest, meant)


def _along(stage: Stage, ahead: Float[Array, "n 2"]) -> Float[Array, "n n"]:
    """How far every other agent is before or behind, in each one's direction [m]."""
    to = stage.agents[None, :, :2] - stage.agents[:, None, :2]
    return jnp.abs((to * ahead[:, None]).sum(-1))


def _in_lanes(stage: Stage) -> _InLanes:
    places, lanes = stage.agents[:, :2], stage.lanes
    points, ahead = (x.reshape(lanes, -1, 2) for x in (stage.points, stage.ahead))
    nearest = squares(places, stage.points).reshape(len(places), lanes, -1).argmin(2)
    rows = jnp.arange(lanes)[None]
    foot, way = points[rows, nearest], ahead[rows, nearest]
    to = places[:, None] - foot
    along, left = (to * way).sum(-1), cross(way, to)
    turned = TURN * (1 - (stage.agents[:, None, 4:6] * way).sum(-1))
    cost = jnp.square(left) + jnp.square(jax.nn.relu(jnp.abs(along) - 2)) + turned
    cost = cost + jnp.where(stage.agents[:, None, 3] > _FASTER[0], _FASTER[1], 0.0)
    may = stage.vehicle.at[0].set(True)
    there = may[:, None] & stage.there.reshape(lanes, -1)[None, :, 0]
    return _InLanes(foot, way, along, left, jnp.where(there, cost, NEVER))


def _pair(stage: Stage, queued: Bool[Array, "n lanes"]) -> tuple[Array, Array]:
    """A lane and the one to its right, and whether there are such two."""
    points, ahead = (x.reshape(stage.lanes, -1, 2) for x in (stage.points, stage.ahead))
    middle, heading = (x[:, x.shape[1] // 2] for x in (points, ahead))
    there = stage.there.reshape(stage.lanes, -1)[:, 0]
    across = middle[None] - middle[:, None]
    right = -cross(heading[:, None], across)
    parallel = (heading @ heading.T > 0.95) & (jnp.abs((across * heading[:, None]).sum(-1)) < 25.0)
    beside = parallel & (right > _APART[0]) & (right < _APART[1]) & there[:, None] & there[None]
    number = queued.sum(0)
    merit = 100 * jnp.minimum(number, 2) + number
    merit = jnp.where(beside, merit[:, None] + merit[None], -1)
    return jnp.stack(jnp.unravel_index(merit.argmax(), merit.shape)), merit.max() >= 0
