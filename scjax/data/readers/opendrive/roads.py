"""Roads, their lane sections and lanes, as an OpenDRIVE file states them."""

from __future__ import annotations

import dataclasses
from typing import Literal, NamedTuple

from scjax.data.readers.opendrive.plan_view import PlanView, read_plan_view
from scjax.data.readers.opendrive.polynomials import Cubics, read_cubics
from scjax.data.readers.xml_elements import Element

RoadEnd = Literal["start", "end"]
_MAX_LANE_ID = 1000


class RoadLink(NamedTuple):
    """What follows at an end of a road.

    Attributes:
      is_junction: whether it is a junction; otherwise a road.
      id: of it.
      contact: the end of the other road that touches this one.
    """

    is_junction: bool
    id: str
    contact: RoadEnd


@dataclasses.dataclass(frozen=True)
class SectionLane:
    """A lane of one lane section.

    Attributes:
      id: positive to the left of the reference line, negative to the right, counted outward.
      type: word of the file, such as driving or sidewalk.
      forward: whether traffic drives along the reference line.
      width: [m], or None if ``border`` is given.
      border: t-coordinate of the outer border [m], if the file has no width.
      predecessor, successor: ids of the lanes before and after it along the reference line; empty where not linked.
    """

    id: int
    type: str
    forward: bool
    width: Cubics | None
    border: Cubics | None
    predecessor: tuple[int, ...]
    successor: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class LaneSection:
    """The lanes on one side of a road, where their number does not change.

    Attributes:
      start, end: on the road [m].
      lanes: from the reference line outward, without the center lane.
    """

    start: float
    end: float
    lanes: tuple[SectionLane, ...]


@dataclasses.dataclass(frozen=True)
class MapRoad:
    """A road.

    Attributes:
      id: of the road.
      junction: id of the junction that it lies in, "" outside of junctions.
      length: [m].
      is_motorway: whether the file calls it a motorway.
      plan_view, elevation, superelevation, lane_offset: the reference line, [m] and [rad].
      sides: sections on the left and on the right.
      predecessor, successor: what follows at its ends.
      element: the XML element, for messages and signals.
    """

    id: str
    junction: str
    length: float
    is_motorway: bool
    plan_view: PlanView
    elevation: Cubics
    superelevation: Cubics
    lane_offset: Cubics
    sides: tuple[tuple[LaneSection, ...], tuple[LaneSection, ...]]
    predecessor: RoadLink | None
    successor: RoadLink | None
    element: Element

    def side(self, lane_id: int) -> tuple[LaneSection, ...]:
        """The sections of the side that a lane lies on."""
        return self.sides[0] if lane_id > 0 else self.sides[1]


def read_road(element: Element) -> MapRoad:
    """A <road>.

    Raises:
      ValueError: something is missing, no number, absurd or contradictory; says where.
    """
    length = element.number("length", most=1e6)
    if length <= 0:
        raise element.fault(f"length is {length:g}: it must be positive")
    junction = element.text("junction", "-1")
    elevation, lateral, lanes = (element.first(tag) for tag in ("elevationProfile", "lateralProfile", "lanes"))
    if lanes is None or not lanes.all("laneSection"):
        raise element.fault("has no <lanes> with a <laneSection>")
    rule = element.text("rule", "RHT")
    if rule not in ("RHT", "LHT"):
        raise element.fault(f"rule is {rule[:40]!r}, neither RHT nor LHT")
    return MapRoad(
        id=element.text("id"),
        junction="" if junction == "-1" else junction,
        length=length,
        is_motorway=any(item.text("type", "") == "motorway" for item in element.all("type")),
        plan_view=read_plan_view(element),
        elevation=read_cubics(elevation.all("elevation") if elevation else ()),
        superelevation=read_cubics(lateral.all("superelevation") if lateral else ()),
        lane_offset=read_cubics(lanes.all("laneOffset"), zero_before=True),
        sides=_read_sides(lanes.all("laneSection"), length, rule == "LHT"),
        predecessor=_read_link(element, "predecessor"),
        successor=_read_link(element, "successor"),
        element=element,
    )


def _read_link(road: Element, tag: str) -> RoadLink | None:
    links = road.first("link")
    element = links.first(tag) if links is not None else None
    if element is None:
        return None
    contact = element.text("contactPoint", "start")
    if contact not in ("start", "end"):
        raise element.fault(f"contactPoint is {contact[:40]!r}, neither start nor end")
    return RoadLink(element.text("elementType", "road") == "junction", element.text("elementId"), contact)


def _read_sides(
    elements: list[Element], length: float, left_hand: bool
) -> tuple[tuple[LaneSection, ...], tuple[LaneSection, ...]]:
    """Sections of both sides; a section of a single side leaves the one before on the other side in force."""
    elements = sorted(elements, key=lambda element: element.number("s"))
    sides = []
    for name, sign in (("left", 1), ("right", -1)):
        rows = [
            (element.number("s"), element)
            for element in elements
            if element.text("singleSide", "false") != "true" or element.first(name) is not None
        ]
        ends = [start for start, _ in rows[1:]] + [length]
        sides.append(
            tuple(
                LaneSection(start, min(end, length), _read_lanes(element, name, sign, start, left_hand))
                for (start, element), end in zip(rows, ends, strict=True)
                if min(end, length) > start
            )
        )
    return sides[0], sides[1]


def _read_lanes(section: Element, side: str, sign: int, start: float, left_hand: bool) -> tuple[SectionLane, ...]:
    """The lanes of one side, from the reference line outward."""
    group = section.first(side)
    lanes = [_read_lane(element, start, left_hand) for element in group.all("lane")] if group else []
    for lane in lanes:
        if lane.id * sign <= 0 or abs(lane.id) > _MAX_LANE_ID:
            raise section.fault(f"lane {lane.id} cannot lie on the {side}")
    if len({lane.id for lane in lanes}) < len(lanes):
        raise section.fault(f"two lanes on the {side} have one id")
    return tuple(sorted(lanes, key=lambda lane: abs(lane.id)))


def _read_lane(element: Element, start: float, left_hand: bool) -> SectionLane:
    number = element.whole("id")
    widths, borders = element.all("width"), element.all("border")
    link = element.first("link")
    predecessor, successor = (
        tuple(item.whole("id") for item in link.all(tag)) if link is not None else ()
        for tag in ("predecessor", "successor")
    )
    along = (number < 0) != left_hand
    return SectionLane(
        id=number,
        type=element.text("type", "none"),
        forward=along != (element.text("direction", "standard") == "reversed"),
        width=read_cubics(widths, "sOffset", start) if widths or not borders else None,
        border=read_cubics(borders, "sOffset", start) if borders and not widths else None,
        predecessor=predecessor,
        successor=successor,
    )
