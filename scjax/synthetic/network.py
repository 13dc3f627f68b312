"""A road network in the making: lanes with their joins, junctions, and what stands beside the roads.

Everything is laid out for right-hand traffic in a frame of its own; the world mirrors it for left-hand traffic.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from scjax.synthetic.curves import Line

Turn = Literal["left", "through", "right"]
JunctionKind = Literal["four-way", "T", "Y", "complex", "roundabout", "driveway", "merge"]
MPS_OF_MPH = 0.44704


@dataclasses.dataclass
class Lane:
    """A centreline in driving direction.

    Attributes:
      speed: of free traffic [m/s].
      left, right: the next lane on that side that runs the same way.
      junction: of which this lane is a connector, -1 for none; turn, arm, entry: what a connector does, from which
        arm and from which lane.
      rank: who goes first where connectors cross: the lower one.
      height: above the ground [m].
      centre: a two-way turn lane; nobody drives along it.
      kerb: this lane's right edge is the edge of the road.
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
    entry: int = -1
    rank: int = 0
    height: float = 0.0
    centre: bool = False
    kerb: bool = False


@dataclasses.dataclass
class Arm:
    """A road that meets others: where it points to, seen from the junction [rad], and how far off it stops [m].

    ``inbound`` are the lanes that arrive and the only turn that a pocket allows, ``outbound`` those that leave; the
    innermost first.
    """

    angle: float
    stop: float
    inbound: list[tuple[int, Turn | None]] = dataclasses.field(default_factory=list)
    outbound: list[int] = dataclasses.field(default_factory=list)
    rank: int = 0


@dataclasses.dataclass(eq=False)
class Junction:
    """A place where roads meet. ``phases`` are sets of connectors that have green together; none: no signals."""

    kind: JunctionKind
    centre: np.ndarray
    radius: float
    arms: list[Arm]
    connectors: list[int] = dataclasses.field(default_factory=list)
    phases: list[frozenset[int]] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class Lot:
    """A row of parking bays: middle of the row, direction along it [rad], length [m], direction of the cars [rad]."""

    middle: np.ndarray
    along: float
    length: float
    heading: float


@dataclasses.dataclass
class Network:
    """Lanes about the origin, their junctions, and parking.

    Attributes:
      parking: lanes beside whose right edge cars may park; walks: lanes beside which people walk.
      lots: rows of parking bays.
    """

    lanes: list[Lane] = dataclasses.field(default_factory=list)
    junctions: list[Junction] = dataclasses.field(default_factory=list)
    parking: list[int] = dataclasses.field(default_factory=list)
    walks: list[int] = dataclasses.field(default_factory=list)
    lots: list[Lot] = dataclasses.field(default_factory=list)

    def add(self, lane: Lane) -> int:
        """Index of the lane that was added."""
        self.lanes.append(lane)
        return len(self.lanes) - 1

    def join(self, before: int, after: int) -> None:
        """Traffic flows from lane ``before`` into lane ``after``."""
        self.lanes[before].successors.append(after)

    def beside(self, left: int, right: int) -> None:
        """The two run side by side, the same way."""
        self.lanes[left].right, self.lanes[right].left = right, left
