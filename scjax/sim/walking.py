"""Pedestrians: they keep their speed and heading, stop before vehicles that come, and walk around what stands.

Who cannot walk around it turns back.

Jitted, one scene.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from scjax.scene import AgentType
from scjax.scene.geometry import wrap_angle
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents
from scjax.sim.directions import directions

_MAX_SPEED = 2.0  # m/s; faster ones are errors of the source
_USUAL_SPEED, _SLOW = 1.3, 0.8  # m/s, of those who leave the road, and at least of all who walk
STANDS = 0.15
"""m/s; slower pedestrians stand."""
_LOOK_AHEAD = 1.2  # m
_ROOM = 0.7  # m around bodies
_AWAY = 1.3  # rad by which people turn aside
_WAIT_FOR = 1.5  # s of the way of a vehicle that comes


def usual_pace(agents: Agents, on_road: Bool[AnyArray, " N"]) -> Float[AnyArray, " N"]:
    """Speeds at which agents walk where nothing is in the way [m/s].

    Args:
      on_road: agents on a lane, who do not stand there for long.
    """
    walks = agents.speed > STANDS
    speed = jnp.clip(agents.speed, jnp.where(walks, _SLOW, 0.0), _MAX_SPEED)
    return jnp.where(on_road, jnp.maximum(speed, _USUAL_SPEED), speed)


def walk(agents: Agents, pace: Float[AnyArray, " N"], dt: float) -> Agents:
    """Everybody ``dt`` seconds later as if a pedestrian. Who waits has speed 0, so that vehicles may go on.

    Args:
      pace: speed where nothing is in the way [m/s].
    """
    blocked, side = _ahead(agents, agents.heading)
    away, toward, back = (agents.heading + turn for turn in (-_AWAY * side, _AWAY * side, jnp.pi))
    is_free = ~jax.vmap(lambda heading: _ahead(agents, heading)[0])(jnp.stack([away, toward, back]))
    heading = jnp.where(blocked, jnp.where(is_free[0], away, toward), agents.heading)
    blocked = blocked & ~is_free[0] & ~is_free[1]
    turns = blocked & is_free[2]
    moves = (~blocked | turns) & ~_is_threatened(agents)
    speed = jnp.where(moves, pace, 0.0)
    heading = jnp.where(turns, back, heading)
    return agents.replace(
        x=agents.x + speed * dt * jnp.cos(heading),
        y=agents.y + speed * dt * jnp.sin(heading),
        heading=jnp.where(turns & moves, wrap_angle(back), agents.heading),
        speed=speed,
    )


def _others(agents: Agents) -> Bool[AnyArray, "N N"]:
    """Bodies that count for each agent: all but itself and pedestrians."""
    counts = agents.valid & (agents.kind != AgentType.PEDESTRIAN)
    return counts[None] & ~jnp.eye(agents.x.shape[0], dtype=bool)


def _ahead(agents: Agents, heading: Float[AnyArray, " N"]) -> tuple[Bool[AnyArray, " N"], Float[AnyArray, " N"]]:
    """Whether a body is a step ahead of each agent, and on which side most of these are: 1 left, -1 right."""
    look_x, look_y = directions(heading)
    x, y = agents.x + _LOOK_AHEAD * look_x, agents.y + _LOOK_AHEAD * look_y
    cos, sin = directions(agents.heading)
    d_x, d_y = x[:, None] - agents.x[None], y[:, None] - agents.y[None]
    along, across = jnp.abs(d_x * cos[None] + d_y * sin[None]), jnp.abs(d_y * cos[None] - d_x * sin[None])
    inside = (along < 0.5 * agents.length[None] + _ROOM) & (across < 0.5 * agents.width[None] + _ROOM)
    inside &= _others(agents)
    to_x, to_y = agents.x[None] - agents.x[:, None], agents.y[None] - agents.y[:, None]
    left = to_y * look_x[:, None] - to_x * look_y[:, None]
    sides = jnp.where(inside, jnp.where(left > 0, 1, -1), 0).sum(1)
    return inside.sum(1) > 0, jnp.where(sides >= 0, 1.0, -1.0)


def _is_threatened(agents: Agents) -> Bool[AnyArray, " N"]:
    """Whether a vehicle comes that will be at the agent's next steps, but is not there yet."""
    cos, sin = directions(agents.heading)
    x, y = agents.x + _LOOK_AHEAD * cos, agents.y + _LOOK_AHEAD * sin

    def position(at_x, at_y):
        d_x, d_y = at_x[:, None] - agents.x[None], at_y[:, None] - agents.y[None]
        return d_x * cos[None] + d_y * sin[None], jnp.abs(d_y * cos[None] - d_x * sin[None])

    reach = (0.5 * agents.length + _WAIT_FOR * agents.speed)[None]
    wide = (0.5 * agents.width + _ROOM)[None]
    along, across = position(x, y)
    enters = (along > 0) & (along < reach) & (across < wide)
    now_along, now_across = position(agents.x, agents.y)
    is_inside = (jnp.abs(now_along) < reach) & (now_across < wide)
    return (enters & ~is_inside & (agents.speed[None] > 0.5) & _others(agents)).sum(1) > 0
