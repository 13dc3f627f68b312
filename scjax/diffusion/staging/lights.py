"""The light of the ego: which lanes must show it, so that ``captions.facts`` reads the state that is asked for."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool

from scjax.diffusion.staging.spots import Stage, cross
from scjax.scene import Link, Scene, Signal

_OFF, _BENT = 2.0, 0.4  # m that a radian off the ego's heading counts, and one of the whole lane's turn
_REACH = 3  # lanes ahead at most


def lanes_of_light(scene: Scene, stage: Stage) -> Bool[Array, " lanes"]:
    """Those of the ego's way, up to where it forks, that have a signal; all at the fork where none has."""
    mask, links = jnp.asarray(scene.lane_mask), jnp.asarray(scene.links)
    flows = (links == Link.PREDECESSOR) & mask[:, None] & mask[None]
    last = _ego_lane(stage)
    way = last
    for _ in range(_REACH):
        onward = (flows & last[:, None]).any(0) & ~way
        last = jnp.where((last.sum() == 1) & onward.any(), onward, last)
        way = way | last
    lit = way & (jnp.asarray(scene.signals) != Signal.UNKNOWN)
    return jnp.where(lit.any(), lit, last)


def _ego_lane(stage: Stage) -> Bool[Array, " lanes"]:
    """As ``captions.ego_road.ego_lane``: near, along the ego, and rather straight."""
    points, ahead = (x.reshape(stage.lanes, -1, 2) for x in (stage.points, stage.ahead))
    distance = jnp.square(points - stage.agents[:1, None, :2]).sum(-1)
    rows, nearest = jnp.arange(stage.lanes), distance.argmin(1)
    heading = ahead[rows, nearest] @ stage.agents[0, 4:6]
    bent = jnp.abs(cross(ahead[:, :-1], ahead[:, 1:])).sum(1)
    cost = jnp.sqrt(distance.min(1)) + _OFF * jnp.arccos(jnp.clip(heading, -1, 1)) + _BENT * bent
    cost = jnp.where(stage.there.reshape(stage.lanes, -1)[:, 0], cost, jnp.inf)
    return (rows == cost.argmin()) & jnp.isfinite(cost.min())
