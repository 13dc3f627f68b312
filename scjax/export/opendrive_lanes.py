"""The lanes of a road as OpenDRIVE elements."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from scjax.export.roads.lane_borders import LaneBorders, cubic, cubic_values
from scjax.export.roads.wide_road import WideRoad
from scjax.export.xml_text import XmlElement, add_element

_SAME = 5e-3  # m between a polynomial and the one before, which goes on
_STRAIGHT = 1e-3  # m between a polynomial and a straight line, which is written


def add_lanes(
    element: XmlElement,
    road: WideRoad,
    borders: LaneBorders,
    kind: str,
    before: Sequence[int],
    after: Sequence[int],
) -> None:
    """Adds <lanes> to a <road>: one section; offset and widths are cubic between the stations of ``borders``.

    Args:
      kind: OpenDRIVE's type of all lanes.
      before, after: numbers of the lanes of a road before and after, one for each lane from left to right, or none.
    """
    group = add_element(element, "lanes")
    starts = borders.stations
    curves = np.stack([cubic(borders, row, row + 1) for row in range(len(starts) - 1)])  # pieces 4 borders
    middle = sum(lane.number > 0 for lane in road.lanes)
    for s, values in _records(starts, curves[:, :, middle]):
        add_element(group, "laneOffset", s=s, **values)
    section = add_element(group, "laneSection", s=0.0)
    widths = curves[:, :, :-1] - curves[:, :, 1:]

    def add(tag: str, rows: range) -> None:
        if not rows:
            return
        side = add_element(section, tag)
        for row in rows:
            lane = add_element(side, "lane", id=road.lanes[row].number, type=kind, level="false")
            links = add_element(lane, "link")
            for name, numbers in (("predecessor", before), ("successor", after)):
                if numbers:
                    add_element(links, name, id=numbers[row])
            for s, values in _records(starts, widths[:, :, row]):
                add_element(lane, "width", sOffset=s, **values)

    add("left", range(middle))
    line = add_element(add_element(section, "center"), "lane", id=0, type="none", level="false")
    add_element(line, "link")
    add("right", range(middle, len(road.lanes)))


def _records(stations: np.ndarray, curves: np.ndarray) -> Iterator[tuple[float, dict[str, float]]]:
    """Start and coefficients of each polynomial; those that go on like the one before are left out."""
    start, before = 0.0, None
    for s, end, curve in zip(stations[:-1].tolist(), stations[1:].tolist(), curves, strict=True):
        places, curve = np.linspace(s, end, 5), _simplified(curve, end - s)
        if before is not None and np.allclose(
            cubic_values(before, places - start), cubic_values(curve, places - s), 0.0, _SAME
        ):
            continue
        start, before = s, curve
        yield s, dict(zip("abcd", curve.tolist(), strict=True))


def _simplified(curve: np.ndarray, length: float) -> np.ndarray:
    """The straight line between the ends of a polynomial if it is nearly the same."""
    values = cubic_values(curve, np.linspace(0.0, length, 5))
    line = np.array([values[0], (values[-1] - values[0]) / length, 0.0, 0.0])
    return line if np.allclose(values, np.linspace(values[0], values[-1], 5), 0.0, _STRAIGHT) else curve
