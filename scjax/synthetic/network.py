"""Road network of a world: lanes with their links, junctions, and parking.

Networks are for right-hand traffic, in a frame of their own; the world mirrors them for left-hand traffic.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from scjax.synthetic.curves import Line

Turn = Literal["left", "through", "right"]
JunctionType = Literal["four-way", "T", "Y", "complex", "roundabout", "driveway", "merge"]
MPS_PER_MPH = 0.44704


@dataclasses.dataclass
class Lane:
    """A lane.

    Attributes:
      points: centerline in driving direction [m].
      speed: of free traffic [m/s].
      width: [m].
      subtype: as in recordings, "surface_street" or "freeway".
      successors: indices of the lanes that follow.
      left, right: index of the neighboring lane with the same direction.
      junction: index of the junction that a connector belongs to; -1 for other lanes.
      turn, arm, entry_lane: of a connector: its turn, and the indices of the arm and the lane that it starts from.
      rank: right of way among conflicting connectors; lower goes first.
      height: above the ground [m].
      at_curb: the right edge of the lane is the edge of the road.
    """

    points: Line
    speed: float
    width: float = 3.5
    subtype: str = "surface_street"
    successors: list[int] = dataclasses.field(default_factory=list)
    left: int | None = None
    right: int | None = None
    junction: int = -1
    turn: Turn | None = None
    arm: int = -1
    entry_lane: int = -1
    rank: int = 0
    height: float = 0.0
    at_curb: bool = False


@dataclasses.dataclass
class Arm:
    """A road that ends at a junction.

    Attributes:
      angle: its direction, seen from the junction [rad].
      stop_distance: from the center of the junction to the stop line [m].
      inbound: lanes that arrive, innermost first, each with the only turn that a turn pocket allows, else None.
      outbound: lanes that leave, innermost first.
      rank: right of way; lower goes first.
    """

    angle: float
    stop_distance: float
    inbound: list[tuple[int, Turn | None]] = dataclasses.field(default_factory=list)
    outbound: list[int] = dataclasses.field(default_factory=list)
    rank: int = 0


@dataclasses.dataclass(eq=False)
class Junction:
    """A place where roads meet.

    Attributes:
      type: of the junction.
      center, radius: [m].
      arms: roads that meet.
      connectors: indices of the lanes across the junction.
      phases: sets of connectors with green at the same time; empty without signals.
    """

    type: JunctionType
    center: np.ndarray
    radius: float
    arms: list[Arm]
    connectors: list[int] = dataclasses.field(default_factory=list)
    phases: list[frozenset[int]] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class ParkingRow:
    """A row of parking bays: center [m], direction along the row [rad], length [m], heading of the vehicles [rad]."""

    center: np.ndarray
    direction: float
    length: float
    vehicle_heading: float


@dataclasses.dataclass
class Network:
    """Lanes around the origin, junctions and parking.

    Attributes:
      parking_lanes: lanes with parking along their right edge.
      sidewalk_lanes: lanes with a sidewalk along their right edge.
      parking_rows: rows of parking bays off the road.
    """

    lanes: list[Lane] = dataclasses.field(default_factory=list)
    junctions: list[Junction] = dataclasses.field(default_factory=list)
    parking_lanes: list[int] = dataclasses.field(default_factory=list)
    sidewalk_lanes: list[int] = dataclasses.field(default_factory=list)
    parking_rows: list[ParkingRow] = dataclasses.field(default_factory=list)

    def add_lane(self, lane: Lane) -> int:
        """Adds a lane and returns its index."""
        self.lanes.append(lane)
        return len(self.lanes) - 1

    def link(self, lane: int, successor: int) -> None:
        """Lets traffic flow from ``lane`` into ``successor``."""
        self.lanes[lane].successors.append(successor)

    def set_neighbors(self, left: int, right: int) -> None:
        """Makes two lanes with the same direction neighbors."""
        self.lanes[left].right, self.lanes[right].left = right, left

    def lanes_abreast(self, lane: int) -> list[int]:
        """``lane`` and all its neighbors, from the left."""
        while (left := self.lanes[lane].left) is not None:
            lane = left
        abreast = [lane]
        while (right := self.lanes[abreast[-1]].right) is not None:
            abreast.append(right)
        return abreast
