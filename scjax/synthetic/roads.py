"""Roads: the lanes of both directions along a reference line, with turn pockets and ending lanes."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from scjax.scene.polyline import cumulative_length, smoothstep
from scjax.synthetic.curves import TURN_SPACING, Line, arcs, offset_line, transform_line
from scjax.synthetic.network import Arm, Junction, Lane, Network, Turn

_POCKET_TAPER = 18.0  # m over which a turn pocket leaves its lane
_ENDING_TAPER = 30.0  # m over which an ending lane merges
_MIN_ROAD_BEFORE_POCKET = 12.0  # m
_MERGE_RADIUS = 10.0  # m
_TURNING_SPEED = 4.0  # m/s on a turning circle
_MIN_POINT_SPACING = 0.3  # m between a cut and the next point of a lane


@dataclasses.dataclass(frozen=True)
class RoadProfile:
    """What all lanes of a road share.

    Attributes:
      speed: of free traffic [m/s].
      width: of a lane [m].
      median: width between the two directions [m].
      subtype: as in ``Lane``.
      parking, sidewalk: along the right edge.
      height: above the ground [m].
    """

    speed: float
    width: float = 3.5
    median: float = 0.0
    subtype: str = "surface_street"
    parking: bool = False
    sidewalk: bool = False
    height: float = 0.0


@dataclasses.dataclass(frozen=True)
class Carriageway:
    """One direction of a road.

    Attributes:
      lanes: number of lanes over the whole length; 0 for the missing direction of a one-way road.
      left_pocket, right_pocket: lengths of turn pockets at the end [m], 0 for none.
      ending: length of one more lane on the right that starts with the road and ends [m], 0 for none.
    """

    lanes: int
    left_pocket: float = 0.0
    right_pocket: float = 0.0
    ending: float = 0.0

    def half_width(self, profile: RoadProfile, arriving: bool) -> float:
        """From the reference line to the edge of the road at a junction where the lanes arrive or leave [m]."""
        has_extra_lane = bool(self.right_pocket) if arriving else bool(self.ending)
        return profile.median / 2 + profile.width * (self.lanes + has_extra_lane)


@dataclasses.dataclass
class CarriagewayEnds:
    """Lanes at the start and at the end of a carriageway, in the form of ``Arm.outbound`` and ``Arm.inbound``."""

    start: list[int]
    end: list[tuple[int, Turn | None]]


def add_road(
    net: Network, line: Line, profile: RoadProfile, forward: Carriageway, backward: Carriageway
) -> tuple[CarriagewayEnds, CarriagewayEnds]:
    """Adds the lanes along the reference line ``line`` and those against it; traffic keeps right of the line."""
    along = _CarriagewayBuilder(net, line, profile, forward).build()
    against = _CarriagewayBuilder(net, line[::-1], profile, backward).build()
    return along, against


def attach_to_arm(arm: Arm, arriving: CarriagewayEnds, leaving: CarriagewayEnds) -> None:
    """Registers the carriageways that arrive and leave at the arm of a junction."""
    arm.inbound, arm.outbound = arriving.end, leaving.start


def add_turning_circle(net: Network, arriving: int, leaving: int, radius: float) -> None:
    """Links lane ``arriving`` to lane ``leaving`` beside it by a loop to the left in two halves; ``radius`` in m."""
    before, after = net.lanes[arriving].points, net.lanes[leaving].points
    heading = float(np.arctan2(*(before[-1] - before[-2])[::-1]))
    half_gap = float(np.hypot(*(after[0] - before[-1]))) / 2
    # Arcs to the right, left and right again, which touch; all have ``radius``.
    aside = float(np.arccos((half_gap + radius) / (2 * radius)))
    half = arcs([-aside, np.pi / 2 + aside], radius, TURN_SPACING)
    first = transform_line(half, before[-1], heading)
    axis = np.array([np.cos(heading), np.sin(heading)])
    middle = (before[-1] + after[0]) / 2
    second = (2 * ((first - middle) @ axis)[:, None] * axis - (first - middle) + middle)[::-1]
    loop = []
    for points in (first, second):
        lane = Lane(points, _TURNING_SPEED, net.lanes[arriving].width, at_curb=True)
        loop.append(net.add_lane(lane))
    net.lanes[loop[1]].points[[0, -1]] = first[-1], after[0]
    for lane, successor in itertools.pairwise([arriving, *loop, leaving]):
        net.link(lane, successor)


class _CarriagewayBuilder:
    """Adds the lanes of one carriageway: sections between the changes of the number of lanes, then extra lanes."""

    def __init__(self, net: Network, line: Line, profile: RoadProfile, carriageway: Carriageway):
        self.net, self.line, self.profile, self.carriageway = net, line, profile, carriageway
        self.arc = cumulative_length(line)
        self.length = length = float(self.arc[-1])
        pocket = max(carriageway.left_pocket, carriageway.right_pocket)
        self.pocket = pocket if pocket and length > pocket + _MIN_ROAD_BEFORE_POCKET else 0.0
        has_room = length > carriageway.ending + self.pocket + _MIN_ROAD_BEFORE_POCKET
        self.ending = carriageway.ending if carriageway.ending and has_room else 0.0
        # Offsets of the centerlines to the left of the reference line [m], innermost first.
        self.offsets = [-(profile.median / 2 + profile.width * (k + 0.5)) for k in range(carriageway.lanes)]
        self.sections: list[list[int]] = []

    def build(self) -> CarriagewayEnds:
        if not self.carriageway.lanes:
            return CarriagewayEnds([], [])
        self._add_sections()
        ends = CarriagewayEnds(list(self.sections[0]), [(k, None) for k in self.sections[-1]])
        if self.ending:
            ends.start.append(self._add_ending_lane())
        if self.pocket and self.carriageway.left_pocket:
            ends.end.insert(0, (self._add_left_pocket(), "left"))
        if self.pocket and self.carriageway.right_pocket:
            ends.end.append((self._add_right_pocket(), "right"))
        return ends

    def _add_lane(self, left: float | np.ndarray, start: float, end: float, at_curb: bool) -> int:
        """A lane with offset ``left`` between two arc lengths of the reference line [m]."""
        line, profile = offset_line(self.line, left), self.profile
        inner = self.arc[(self.arc > start + _MIN_POINT_SPACING) & (self.arc < end - _MIN_POINT_SPACING)]
        positions = np.concatenate([[start], inner, [end]])
        points = np.stack([np.interp(positions, self.arc, line[:, d]) for d in (0, 1)], -1)
        lane = Lane(points, profile.speed, profile.width, profile.subtype, at_curb=at_curb, height=profile.height)
        return self.net.add_lane(lane)

    def _add_sections(self) -> None:
        """The lanes over the whole length, cut where extra lanes start or end."""
        net, length = self.net, self.length
        cuts = [0.0, *([self.ending] if self.ending else []), *([length - self.pocket] if self.pocket else []), length]
        for start, end in itertools.pairwise(cuts):
            has_right_pocket = self.pocket and self.carriageway.right_pocket and end == length
            is_widened = (self.ending and start == 0.0) or has_right_pocket
            lanes = [
                self._add_lane(left, start, end, k == self.carriageway.lanes - 1 and not is_widened)
                for k, left in enumerate(self.offsets)
            ]
            for left_lane, right_lane in itertools.pairwise(lanes):
                net.set_neighbors(left_lane, right_lane)
            if self.sections:
                for lane, successor in zip(self.sections[-1], lanes, strict=True):
                    net.link(lane, successor)
            self.sections.append(lanes)
            if self.profile.parking and not is_widened:
                net.parking_lanes += lanes[-1:]
            if self.profile.sidewalk:
                net.sidewalk_lanes += lanes[-1:]

    def _add_ending_lane(self) -> int:
        net = self.net
        left = self.offsets[-1] - self.profile.width * smoothstep((self.ending - self.arc) / _ENDING_TAPER)
        lane = self._add_lane(left, 0.0, self.ending, True)
        net.lanes[lane].points[-1] = net.lanes[self.sections[1][-1]].points[0]
        net.set_neighbors(self.sections[0][-1], lane)
        net.link(lane, self.sections[1][-1])
        net.junctions.append(Junction("merge", net.lanes[lane].points[-1], _MERGE_RADIUS, []))
        return lane

    def _add_left_pocket(self) -> int:
        lane = self._add_pocket(self.offsets[0], 1.0, self.sections[-2][0], at_curb=False)
        self.net.set_neighbors(lane, self.sections[-1][0])
        return lane

    def _add_right_pocket(self) -> int:
        lane = self._add_pocket(self.offsets[-1], -1.0, self.sections[-2][-1], at_curb=True)
        self.net.set_neighbors(self.sections[-1][-1], lane)
        return lane

    def _add_pocket(self, offset: float, side: float, predecessor: int, at_curb: bool) -> int:
        """A turn pocket that leaves the lane ``predecessor`` with ``offset`` to the left (``side`` 1) or right (-1)."""
        start = self.length - self.pocket
        left = offset + side * self.profile.width * smoothstep((self.arc - start) / _POCKET_TAPER)
        lane = self._add_lane(left, start, self.length, at_curb)
        self.net.lanes[lane].points[0] = self.net.lanes[predecessor].points[-1]
        self.net.link(predecessor, lane)
        return lane
