"""Cross-sections: the lanes of one road along a reference line, with turn pockets, added and ending lanes."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from scjax.synthetic.curves import Line, arc_of, offset, smooth
from scjax.synthetic.network import Arm, Lane, Network, Turn

_TAPER = 18.0  # metres over which a pocket leaves its lane
_LEAST = 12.0  # metres of road before a pocket


@dataclasses.dataclass(frozen=True)
class Profile:
    """What all lanes of a road share: metres, m/s."""

    speed: float
    width: float = 3.5
    median: float = 0.0
    subtype: str = "surface_street"
    centre_turn: bool = False  # the median, 3 m or more of it, is a turn lane for both directions
    parking: bool = False
    walks: bool = False
    height: float = 0.0


@dataclasses.dataclass(frozen=True)
class Side:
    """One direction of a road: lanes all along; lengths of turn pockets at its end and of a lane that ends [m]."""

    lanes: int
    left_pocket: float = 0.0
    right_pocket: float = 0.0
    ending: float = 0.0  # one more lane on the right, up to here

    def half_width(self, profile: Profile, arriving: bool) -> float:
        """From the middle of the road to its edge where it meets a junction [m]."""
        more = bool(self.right_pocket) if arriving else bool(self.ending)
        return profile.median / 2 + profile.width * (self.lanes + more)


@dataclasses.dataclass
class Ends:
    """Lanes of one direction at its start and at its end, as an ``Arm`` lists them."""

    first: list[int]
    last: list[tuple[int, Turn | None]]


def add_road(net: Network, line: Line, profile: Profile, forward: Side, backward: Side) -> tuple[Ends, Ends]:
    """Adds the lanes along ``line`` and those against it; a side of no lanes is left out (one-way road)."""
    return (_add_side(net, line, profile, forward), _add_side(net, line[::-1], profile, backward))


def _add_side(net: Network, line: Line, profile: Profile, side: Side) -> Ends:
    if not side.lanes:
        return Ends([], [])
    arc = arc_of(line)
    total, width = float(arc[-1]), profile.width
    pocket = max(side.left_pocket, side.right_pocket)
    pocket = pocket if pocket and total > pocket + _LEAST else 0.0
    ending = side.ending if side.ending and total > side.ending + pocket + _LEAST else 0.0
    cuts = [0.0, *([ending] if ending else []), *([total - pocket] if pocket else []), total]
    offsets = [-(profile.median / 2 + width * (k + 0.5)) for k in range(side.lanes)]

    def lane(left: float | np.ndarray, start: float, end: float, kerb: bool) -> int:
        points = _between(offset(line, left), arc, start, end)
        height = profile.height
        return net.add(Lane(points, profile.speed, width, profile.subtype, kerb=kerb, height=height))

    sections = []
    for start, end in itertools.pairwise(cuts):
        widened = (ending and start == 0.0) or (pocket and side.right_pocket and end == total)
        kerbs = [k == side.lanes - 1 and not widened for k in range(side.lanes)]
        lanes = [lane(left, start, end, kerb) for left, kerb in zip(offsets, kerbs, strict=True)]
        for a, b in itertools.pairwise(lanes):
            net.beside(a, b)
        if sections:
            for before, after in zip(sections[-1], lanes, strict=True):
                net.join(before, after)
        sections.append(lanes)
        if profile.parking and not widened:
            net.parking += lanes[-1:]
        if profile.walks:
            net.walks += lanes[-1:]
    first = list(sections[0])
    last: list[tuple[int, Turn | None]] = [(k, None) for k in sections[-1]]
    inner, outer = offsets[0], offsets[-1]
    if ending:
        left = outer - width * smooth((ending - arc) / 30.0)
        extra = lane(left, 0.0, ending, True)
        net.lanes[extra].points[-1] = net.lanes[sections[1][-1]].points[0]
        net.beside(sections[0][-1], extra)
        net.join(extra, sections[1][-1])
        first.append(extra)
    if pocket and side.left_pocket:
        left = inner + width * smooth((arc - (total - pocket)) / _TAPER)
        extra = lane(left, total - pocket, total, False)
        net.lanes[extra].points[0] = net.lanes[sections[-2][0]].points[-1]
        net.beside(extra, sections[-1][0])
        net.join(sections[-2][0], extra)
        last.insert(0, (extra, "left"))
    if pocket and side.right_pocket:
        left = outer - width * smooth((arc - (total - pocket)) / _TAPER)
        extra = lane(left, total - pocket, total, True)
        net.lanes[extra].points[0] = net.lanes[sections[-2][-1]].points[-1]
        net.beside(sections[-1][-1], extra)
        net.join(sections[-2][-1], extra)
        last.append((extra, "right"))
    if profile.centre_turn and not side.left_pocket:
        middle = net.add(Lane(line.copy(), profile.speed, width, profile.subtype, centre=True))
        net.lanes[middle].height = profile.height
        last.insert(0, (middle, "left"))
    return Ends(first, last)


def arrive(arm: Arm, incoming: Ends, leaving: Ends) -> None:
    """Notes at a junction's arm which lanes of a road end and start there."""
    arm.inbound, arm.outbound = incoming.last, leaving.first


def _between(points: Line, arc: np.ndarray, start: float, end: float) -> Line:
    """Points whose place along the reference line lies between two arc lengths, and those at the two."""
    inner = arc[(arc > start + 0.3) & (arc < end - 0.3)]
    at = np.concatenate([[start], inner, [end]])
    return np.stack([np.interp(at, arc, points[:, d]) for d in (0, 1)], -1)
