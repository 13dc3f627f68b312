"""A road of an OpenDRIVE file with all of its lanes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from scjax.export.roads.lane_borders import LaneBorders
from scjax.export.roads.lane_curves import LaneCurve
from scjax.export.roads.planned_road import PlannedRoad


@dataclasses.dataclass(frozen=True)
class RoadLane:
    """A lane of a road.

    Attributes:
      road: the road of one lane that it was.
      curve: its middle, in the direction of the wide road.
      number: from the middle of the road outwards; negative on the right, for traffic in the direction of the road.
      start, end: the part of the road of one lane that it is, in the direction of traffic [m].
    """

    road: PlannedRoad
    curve: LaneCurve
    number: int
    start: float
    end: float


@dataclasses.dataclass
class WideRoad:
    """A road with lanes beside each other.

    Attributes:
      id: from 1.
      curve: its reference line.
      lanes: from left to right.
      borders: of the lanes of a road that was joined; None: it has one lane.
      junction: id of the junction that it lies in, 0 outside of junctions.
      before, after: ids of roads at its ends with the same lanes, 0 where there is none.
      junction_before, junction_after: ids of the junctions at its ends, 0 where there is none.
    """

    id: int
    curve: LaneCurve
    lanes: tuple[RoadLane, ...]
    borders: LaneBorders | None = None
    junction: int = 0
    before: int = 0
    after: int = 0
    junction_before: int = 0
    junction_after: int = 0


class LaneEnd(NamedTuple):
    """An end of a lane of a wide road.

    Attributes:
      road: id of the wide road.
      number: of the lane.
      at_end: whether it is at the end of the wide road.
    """

    road: int
    number: int
    at_end: bool


class LaneEnds(NamedTuple):
    """Where the traffic of a road of one lane enters and leaves the wide roads that it became a lane of.

    Attributes:
      first: where it enters.
      last: where it leaves, on another wide road if that was cut in two.
    """

    first: LaneEnd
    last: LaneEnd


def lane_ends(roads: Sequence[WideRoad]) -> dict[int, LaneEnds]:
    """The ends of all lanes, by the ids of the roads of one lane that they were."""
    parts: dict[int, list[tuple[float, int, int]]] = {}
    for road in roads:
        for lane in road.lanes:
            parts.setdefault(lane.road.id, []).append((lane.start, road.id, lane.number))
    ends = {}
    for id, row in parts.items():
        (_, first, number), (_, last, _) = min(row), max(row)
        ends[id] = LaneEnds(LaneEnd(first, number, number > 0), LaneEnd(last, number, number < 0))
    return ends
