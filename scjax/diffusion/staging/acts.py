"""How each rare event is staged: a place where it can happen, and the agents that have least to change for it.

What an event needs is what ``captions.events`` reads, with some room. Of one scene, without batch axes.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from scjax.data.captions.events import Event
from scjax.diffusion.staging.corridor import corridor
from scjax.diffusion.staging.spots import (
    Poses,
    Spot,
    Stage,
    beside,
    best_two,
    blocked,
    change,
    crowd,
    given_to,
    least,
    left_of,
    pose,
    slow_down,
    squares,
    twice,
)

_EDGE, _KERB = 0.8, 3.2  # m off the middle of a lane: who stands at its edge, and who is parked beside
_LEAN = 0.18  # rad towards the lane into which one cuts


def _wrong_way(stage: Stage) -> Poses:
    spot = Spot(stage.points, -stage.ahead, stage.calm, along=1.2, aside=0.6)
    who, where, good = least(change(stage, stage.vehicle, spot) + crowd(stage, spot))
    return pose(stage, spot, who, where, good, slowest=4.0, fastest=12.0)


def _jaywalker(stage: Stage) -> Poses:
    spot = Spot(stage.points, stage.ahead, stage.calm, along=1.2, aside=1.0)
    who, where, good = least(change(stage, stage.walker, spot, turn=0.0) + crowd(stage, spot))
    poses = pose(stage, spot, who, where, good, slowest=1.0, fastest=2.2)
    across = left_of(stage.ahead)[where]
    across = across * jnp.where((stage.agents[who, 4:6] * across).sum() < 0, -1.0, 1.0)
    walks = jnp.where(poses.meant[:, None], across, poses.ahead)
    return poses._replace(ahead=walks, room=poses.room[:, ::-1])


def _stopped(stage: Stage) -> Poses:
    spot = Spot(stage.points, stage.ahead, stage.calm, along=1.2, aside=0.5)
    cost = change(stage, stage.vehicle, spot) + crowd(stage, spot) + blocked(stage, spot)[None]
    who, where, good = least(cost + slow_down(stage))
    return pose(stage, spot, who, where, good, fastest=-0.3)


def _double_parking(stage: Stage) -> Poses:
    """One stands at the edge of an outer lane, another beside it at the kerb."""
    edge, kerb = beside(stage, _EDGE), beside(stage, _KERB)  # on both sides of every lane
    free = ~((squares(kerb, stage.points) < 2.2**2) & stage.there[None]).any(1)
    ahead, calm = twice(stage.ahead), twice(stage.calm) & free
    one, other = Spot(edge, ahead, calm, along=1.2, aside=0.1), Spot(kerb, ahead, calm, along=3.0, aside=0.3)
    stands = slow_down(stage)
    cost = change(stage, stage.vehicle, one) + crowd(stage, one, along=5.0, aside=2.1) + blocked(stage, one)[None]
    who, whom, where, good = best_two(cost + stands, change(stage, stage.vehicle, other) + stands)
    doubled = pose(stage, one, who, where, good, fastest=-0.3)
    parked = pose(stage, other, whom, where, good, fastest=-0.3)
    return given_to(parked.meant, parked, doubled)


def _cut_in(stage: Stage) -> Poses:
    """One leaves the lane beside for the lane of another, shortly before it."""
    along = twice(stage.ahead @ stage.ahead.T > 0.95)
    lane = (squares(beside(stage, 3.5), stage.points) < 1.9**2) & along & stage.there[None]
    side = jnp.repeat(jnp.array([-1.0, 1.0]), len(stage.points))[:, None]
    ahead, calm = twice(stage.ahead), twice(stage.calm) & lane.any(1)
    leaning = (ahead - _LEAN * side * left_of(ahead)) / np.hypot(1, _LEAN)
    behind = twice(stage.points - 11.0 * stage.ahead)
    one = Spot(beside(stage, 1.3), leaning, calm, along=1.2, aside=0.4)
    other = Spot(behind, ahead, calm & (jnp.abs(behind).max(-1) < 29.0), along=3.0, aside=0.5)
    slow = 2 * jax.nn.relu(4.0 - stage.agents[:, 3])[:, None]
    cost = change(stage, stage.vehicle, one) + crowd(stage, one) + slow
    who, whom, where, good = best_two(cost, change(stage, stage.vehicle, other) + slow)
    cutting = pose(stage, one, who, where, good, slowest=4.0, fastest=15.0)
    follows = pose(stage, other, whom, where, good, slowest=3.0, fastest=15.0)
    return given_to(follows.meant, follows, cutting)


ACTS: dict[Event, Callable[[Stage], Poses]] = {
    "wrong-way driver": _wrong_way, "jaywalker": _jaywalker, "stopped vehicle in lane": _stopped,
    "double parking": _double_parking, "emergency corridor": corridor, "cut-in": _cut_in,
}  # fmt: skip
