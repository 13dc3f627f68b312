"""The lanes of a road as OpenDRIVE elements."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.export.lane_borders import LaneBorders, cubic
from scjax.export.wide_road import WideRoad
from scjax.export.xml_text import XmlElement, add_element


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
    starts = borders.stations[:-1].tolist()
    curves = np.stack([cubic(borders, row, row + 1) for row in range(len(starts))])  # pieces 4 borders
    middle = sum(lane.number > 0 for lane in road.lanes)
    for s, values in zip(starts, curves[:, :, middle].tolist(), strict=True):
        add_element(group, "laneOffset", s=s, **dict(zip("abcd", values, strict=True)))
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
            for s, values in zip(starts, widths[:, :, row].tolist(), strict=True):
                add_element(lane, "width", sOffset=s, **dict(zip("abcd", values, strict=True)))

    add("left", range(middle))
    line = add_element(add_element(section, "center"), "lane", id=0, type="none", level="false")
    add_element(line, "link")
    add("right", range(middle, len(road.lanes)))
