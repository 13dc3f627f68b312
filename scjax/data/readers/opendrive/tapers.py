"""Lanes that open from no width, or close to none, joined to the lane beside them.

OpenDRIVE has no link for them: a car changes into such a lane. A lane graph has one: the lane leaves the middle of the
lane beside it where it opens, and reaches its own middle where it is open; the other way round where it closes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from scjax.data.readers.opendrive.lane_lines import LaneKey, LaneLine
from scjax.data.readers.opendrive.lane_links import Links
from scjax.scene.polyline import cumulative_length, smoothstep

CLOSED_WIDTH = 0.5  # m at an end of a lane that opens or closes there
_OPEN_SHARE = 0.9  # of the greatest width, from which on a lane is open
_LEAST_LENGTH = 15.0  # m of the way over, if the lane is as long


def join_tapers(lines: dict[LaneKey, LaneLine], pairs: Links, is_for_cars: Callable[[LaneLine], bool]) -> None:
    """Moves the ends of lanes that open or close onto the lanes beside them, and adds the links to ``pairs``."""
    starts, ends = {b for _, b in pairs}, {a for a, _ in pairs}
    before: dict[LaneKey, set[LaneKey]] = {}
    after: dict[LaneKey, set[LaneKey]] = {}
    for a, b in pairs:
        before.setdefault(b, set()).add(a)
        after.setdefault(a, set()).add(b)
    for key in [key for key, line in lines.items() if is_for_cars(line)]:
        for is_end, linked, others in ((False, starts, before), (True, ends, after)):
            line = lines[key]
            if key in linked or line.widths[-1 if is_end else 0] > CLOSED_WIDTH:
                continue
            beside = _lane_beside(line, lines, is_end, is_for_cars)
            if beside is None or beside.key not in others:
                continue
            lines[key] = dataclasses.replace(line, points=_way_over(line, beside, is_end))
            pairs |= {(key, other) if is_end else (other, key) for other in others[beside.key]}


def _lane_beside(
    line: LaneLine, lines: dict[LaneKey, LaneLine], is_end: bool, is_for_cars: Callable[[LaneLine], bool]
) -> LaneLine | None:
    """The open lane beside an end that goes the same way; the inner one of two."""
    road, section, lane = line.key
    step = 1 if lane > 0 else -1
    for number in (lane - step, lane + step):
        other = lines.get(LaneKey(road, section, number))
        if other is None or not is_for_cars(other) or other.lane.forward != line.lane.forward:
            continue
        if other.widths[-1 if is_end else 0] > 2 * CLOSED_WIDTH:
            return other
    return None


def _way_over(line: LaneLine, beside: LaneLine, is_end: bool) -> np.ndarray:
    """Points of a lane that begins (ends) in the middle of the lane beside it [points, 3]."""
    order = slice(None, None, -1 if is_end else 1)
    own, other, widths = line.points[order], beside.points[order], line.widths[order]
    arc = cumulative_length(other)
    length = arc[int(np.argmax(widths >= _OPEN_SHARE * widths.max()))]
    length = min(max(float(length), _LEAST_LENGTH), float(arc[-1]))
    return (other + smoothstep(arc / length)[:, None] * (own - other))[order]
