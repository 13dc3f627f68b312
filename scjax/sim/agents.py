"""Agents of a simulation at one moment, and where they are on the lanes at its start."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray

MAX_SIMULATED = 1024  # agents of one roll-out


@pytree
class LanePlaces(Replaceable):
    """Where N agents are on the lanes at the start.

    Attributes:
      lane: index; -1 for agents that follow no lane.
      along: of the center along the lane [m].
      lateral: of the center to the left of the centerline [m].
      heading: relative to the lane [rad].
      is_parked: the agent never moves.
    """

    lane: Int[AnyArray, "*b N"]
    along: Float[AnyArray, "*b N"]
    lateral: Float[AnyArray, "*b N"]
    heading: Float[AnyArray, "*b N"]
    is_parked: Bool[AnyArray, "*b N"]


@pytree
class Agents(Replaceable):
    """N agents at one moment, with padding; the frame is that of the road network.

    Attributes:
      x, y, z: center of the box [m].
      heading: [rad].
      speed: [m/s].
      valid: False for padding and for agents that have left the map.
      length, width, height: [m].
      kind: ``AgentType``.
      entries: how often the row has been given to a vehicle that enters the map.
    """

    x: Float[AnyArray, "*b N"]
    y: Float[AnyArray, "*b N"]
    z: Float[AnyArray, "*b N"]
    heading: Float[AnyArray, "*b N"]
    speed: Float[AnyArray, "*b N"]
    valid: Bool[AnyArray, "*b N"]
    length: Float[AnyArray, "*b N"]
    width: Float[AnyArray, "*b N"]
    height: Float[AnyArray, "*b N"]
    kind: Int[AnyArray, "*b N"]
    entries: Int[AnyArray, "*b N"]


def agent_columns(agents: Agents, rows: Int[np.ndarray, " n"]) -> Float64[np.ndarray, "n 9"]:
    """Columns of ``Scene.agents`` of some agents, in the frame of the road network; NumPy on the host."""
    columns = [agents.x, agents.y, agents.z, agents.speed, np.cos(agents.heading), np.sin(agents.heading)]
    columns += [agents.length, agents.width, agents.height]
    return np.stack([np.asarray(column, np.float64)[rows] for column in columns], -1)
