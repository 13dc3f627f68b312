"""The lanes of a map as arrays that a jitted simulation reads."""

from __future__ import annotations

from jaxtyping import Bool, Float, Int

from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray

MAX_SUCCESSORS = 8
MAX_CONFLICTS = 16  # of one lane
POINT_SPACING = 1.0  # m at most, between the points of a lane
NONE = -1  # index of a lane, signal or conflict that does not exist


@pytree
class RoadNetwork(Replaceable):
    """L lanes with P points and C conflicts, padded; indices are -1 where there is nothing.

    Attributes:
      x, y, z: points of all lanes, one lane after the other, equally spaced within a lane [m].
      heading: direction of travel at each point [rad].
      lane: index of the lane of each point.
      limit: speed at which drivers take each point [m/s].
      first: row of the first point of each lane.
      intervals: number of points of each lane less one.
      spacing: between the points of each lane [m].
      length: of each lane in xy [m].
      successors: lanes that follow; of more than eight the first ones.
      turn: change of heading along the lane, positive to the left [rad].
      signal: row of the signal at the start of the lane.
      left, right: neighbors that run the same way.
      left_span, right_span: where both run side by side: start and end on the lane, start and end on the neighbor [m].
      is_exit: vehicles leave the map at the end of the lane.
      is_entry: vehicles enter the map at its start.
      conflicts: rows of the conflicts of each lane.
      conflict_start, conflict_end: part of the lane on which vehicles of both lanes collide [m].
      conflict_other: row of the same conflict as the other lane sees it.
      conflict_merges: the two lanes lead into the same lane there.
      conflict_rank: right of way of the lane; higher goes first.
    """

    x: Float[AnyArray, "*b P"]
    y: Float[AnyArray, "*b P"]
    z: Float[AnyArray, "*b P"]
    heading: Float[AnyArray, "*b P"]
    lane: Int[AnyArray, "*b P"]
    limit: Float[AnyArray, "*b P"]
    first: Int[AnyArray, "*b L"]
    intervals: Int[AnyArray, "*b L"]
    spacing: Float[AnyArray, "*b L"]
    length: Float[AnyArray, "*b L"]
    successors: Int[AnyArray, "*b L 8"]
    turn: Float[AnyArray, "*b L"]
    signal: Int[AnyArray, "*b L"]
    left: Int[AnyArray, "*b L"]
    right: Int[AnyArray, "*b L"]
    left_span: Float[AnyArray, "*b L 4"]
    right_span: Float[AnyArray, "*b L 4"]
    is_exit: Bool[AnyArray, "*b L"]
    is_entry: Bool[AnyArray, "*b L"]
    conflicts: Int[AnyArray, "*b L 16"]
    conflict_start: Float[AnyArray, "*b C"]
    conflict_end: Float[AnyArray, "*b C"]
    conflict_other: Int[AnyArray, "*b C"]
    conflict_merges: Bool[AnyArray, "*b C"]
    conflict_rank: Int[AnyArray, "*b C"]
