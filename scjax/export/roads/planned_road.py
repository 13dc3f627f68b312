"""A road of an OpenDRIVE file before it is written."""

from __future__ import annotations

import dataclasses

from scjax.export.roads.lane_curves import LaneCurve


@dataclasses.dataclass
class PlannedRoad:
    """A road with one lane.

    Attributes:
      id: from 1.
      curve: middle of the lane.
      lane: index of the first lane.
      start: arc length on it at which the road begins [m].
      lanes: indices of all lanes that the road runs along, in order.
      junction: id of the junction that it lies in, 0 outside of junctions.
      before, after: ids of the roads at its ends, 0 where a junction or nothing is.
      junction_before, junction_after: ids of the junctions at its ends, 0 where a road or nothing is.
    """

    id: int
    curve: LaneCurve
    lane: int
    start: float
    lanes: tuple[int, ...]
    junction: int = 0
    before: int = 0
    after: int = 0
    junction_before: int = 0
    junction_after: int = 0
