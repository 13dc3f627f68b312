"""Lane sections cut where a lane gains or loses its width, so that every lane has a width all along."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.data.readers.opendrive.roads import LaneSection, MapRoad, SectionLane

NO_WIDTH = 0.02  # m; narrower is closed
_PROBE_STEP = 0.5  # m
_MIN_LENGTH = 5.0  # m of a section that is cut off; a lane may begin or end with no width for less


def cut_sections(road: MapRoad) -> MapRoad:
    """The road with sections cut at places where a lane opens or closes."""
    left, right = (tuple(part for section in side for part in _cut(section)) for side in road.sides)
    return dataclasses.replace(road, sides=(left, right))


def _width_probes(section: LaneSection, lane: SectionLane) -> tuple[np.ndarray, np.ndarray]:
    """Places at most 0.5 m apart [m], and the width there [m]; those of a lane with a border are empty."""
    if lane.width is None:
        return np.zeros(0), np.zeros(0)
    if not lane.width.coefficients[:, 1:].any() and (lane.width.coefficients[:, 0] > NO_WIDTH).all():
        return np.array([section.start, section.end]), np.full(2, lane.width.coefficients[0, 0])
    count = int((section.end - section.start) / _PROBE_STEP) + 2
    inner = lane.width.starts[(lane.width.starts > section.start) & (lane.width.starts < section.end)]
    s = np.unique(np.concatenate([np.linspace(section.start, section.end, count), inner]))
    with np.errstate(over="ignore", invalid="ignore"):
        return s, lane.width.values(s, np.append(s[:-1], (s[-2] + s[-1]) / 2))


def _cut(section: LaneSection) -> list[LaneSection]:
    places: set[float] = set()
    for lane in section.lanes:
        s, width = _width_probes(section, lane)
        is_open = np.flatnonzero(width > NO_WIDTH)
        if len(is_open):
            places |= {float(s[max(is_open[0] - 1, 0)]), float(s[min(is_open[-1] + 1, len(s) - 1)])}
    bounds = [section.start]
    for place in sorted(places):
        if place > bounds[-1] + _MIN_LENGTH and place < section.end - _MIN_LENGTH:
            bounds.append(place)
    bounds.append(section.end)
    if len(bounds) == 2:
        return [section]
    last = len(bounds) - 2
    return [
        LaneSection(
            bounds[k],
            bounds[k + 1],
            tuple(
                dataclasses.replace(
                    lane,
                    predecessor=lane.predecessor if k == 0 else (lane.id,),
                    successor=lane.successor if k == last else (lane.id,),
                )
                for lane in section.lanes
            ),
        )
        for k in range(last + 1)
    ]
