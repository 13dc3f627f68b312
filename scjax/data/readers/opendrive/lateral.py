"""Where the borders of lanes run beside the reference line: offsets and widths, without the jumps of exporters."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from scjax.data.readers.opendrive.roads import LaneSection, MapRoad, SectionLane
from scjax.scene.polyline import smoothstep

_SMALLEST_JUMP = 1e-3  # m
_LEAST_REACH, _REACH = 3.0, 10.0  # m before and after a jump, and for each meter of it

Borders = Float64[np.ndarray, "borders n"]
"""t-coordinates [m]: of the center of the road, then of the outer border of every lane, from the center outward."""


def lane_borders(road: MapRoad, section: LaneSection, s: np.ndarray, at: np.ndarray, bounds: np.ndarray) -> Borders:
    """Borders of a section at places ``s`` [m]. Jumps between two stretches are drawn out to a smooth way.

    No car can follow a lane that steps sideways, and no road does; exporters write such steps where they round widths.

    Args:
      at: places that say which record counts, as in ``Cubics.values``.
      bounds: ends of the stretches, from the start to the end of the section [m].
    """
    borders = _borders(road, section, s, at)
    inner = bounds[1:-1]
    if not len(inner):
        return borders
    middle = (bounds[1:] + bounds[:-1]) / 2
    jumps = _borders(road, section, inner, middle[1:]) - _borders(road, section, inner, middle[:-1])
    for k in np.flatnonzero((np.abs(jumps) > _SMALLEST_JUMP).any(0)):
        place = inner[k]
        reach = np.maximum(_LEAST_REACH, _REACH * np.abs(jumps[:, k]))[:, None]
        low, high = np.maximum(place - reach, section.start), np.minimum(place + reach, section.end)
        borders = borders + jumps[:, k, None] * (smoothstep((s - low) / (high - low)) - (at > place))
    outward = np.array([0, *(np.sign(lane.id) for lane in section.lanes)])[:, None]
    for row in range(1, len(borders)):  # a border stays outside of the one before
        side = outward[row]
        borders[row] = side * np.maximum(side * borders[row], side * borders[row - 1])
    return borders


def _borders(road: MapRoad, section: LaneSection, s: np.ndarray, at: np.ndarray) -> Borders:
    borders = [road.lane_offset.values(s, at)]
    for lane in section.lanes:
        borders.append(_outer_border(lane, borders[-1], s, at))
    return np.stack(borders)


def _outer_border(lane: SectionLane, inner: np.ndarray, s: np.ndarray, at: np.ndarray) -> np.ndarray:
    """t-coordinate of a lane's outer border [m]; never on the inner side of the inner border.

    Some exporters write the distance of a border on the right, not its t-coordinate, which would be below 0.
    """
    sign = np.sign(lane.id)
    if lane.border is not None:
        border = lane.border.values(s, at)
        is_distance = (sign * border < 0).all() and (sign * inner >= -_SMALLEST_JUMP).all()
        return inner + sign * np.maximum(sign * ((-border if is_distance else border) - inner), 0.0)
    return inner if lane.width is None else inner + sign * np.maximum(lane.width.values(s, at), 0.0)
