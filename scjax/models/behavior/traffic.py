"""What the behavior network knows of a scene: agents, their last motions, and the ways that they follow."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray

WAY = np.array([0, 2, 4, 6, 8, 10, 12, 14, 16.5, 19, 22, 25, 28, 32, 36, 40, 46, 54, 64, 80], np.float32)
"""Distances along the way of an agent, from the foot of its center, at which the network knows it [m]."""


@pytree
class Traffic(Replaceable):
    """N agents at one moment in any frame.

    Agents without a lane have a way straight ahead and ``has_way`` False.

    Attributes:
      x, y, heading: center of the box and direction [m, rad].
      length, width: [m].
      kind: ``AgentType``.
      valid: False for padding and for agents that are gone.
      motions: last motions, the latest first: forward, left [m] and turn [rad] in the agent's frame before each.
      known: which of them were observed.
      way_x, way_y: points of the way at the distances ``WAY`` [m].
      limit: speed of the road at these points [m/s].
      inside: False for points behind the end of the way.
      has_way: the agent follows a lane.
      signal: ``Signal`` of the first one ahead.
      signal_gap: distance of the center from its stop line [m]; large without a signal.
      end_gap: distance of the center from the end of a way that ends on the map [m]; large for others.
    """

    x: Float[AnyArray, "*b N"]
    y: Float[AnyArray, "*b N"]
    heading: Float[AnyArray, "*b N"]
    length: Float[AnyArray, "*b N"]
    width: Float[AnyArray, "*b N"]
    kind: Int[AnyArray, "*b N"]
    valid: Bool[AnyArray, "*b N"]
    motions: Float[AnyArray, "*b N H 3"]
    known: Bool[AnyArray, "*b N H"]
    way_x: Float[AnyArray, "*b N W"]
    way_y: Float[AnyArray, "*b N W"]
    limit: Float[AnyArray, "*b N W"]
    inside: Bool[AnyArray, "*b N W"]
    has_way: Bool[AnyArray, "*b N"]
    signal: Int[AnyArray, "*b N"]
    signal_gap: Float[AnyArray, "*b N"]
    end_gap: Float[AnyArray, "*b N"]

    def take(self, rows: Int[AnyArray, "*rows"]) -> Traffic:
        """Some agents of one scene."""
        return jax.tree.map(lambda values: values[rows], self)


FAR = 1000.0
"""Gap to what is not there [m]."""
