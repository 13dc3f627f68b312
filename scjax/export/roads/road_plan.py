"""Lanes -> roads of one lane and junctions, in the form that consumers of OpenDRIVE accept.

Lanes of one kind that follow each other one by one are one road. Every fork and merge is a junction, and so is every
place where lanes cross. A short lane from a fork to a merge is a road of the junction as a whole; of other lanes the
part at the fork, merge or crossing is cut off for it. Junctions that share such a road are one.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence

from scjax.export.roads.crossings import LaneCrossing
from scjax.export.roads.junction_spans import JunctionSpan, junction_spans
from scjax.export.roads.lane_curves import LaneCurve, cut_curve, without_short_bend
from scjax.export.roads.lane_nodes import LaneNode
from scjax.export.roads.planned_road import PlannedRoad
from scjax.export.roads.road_chains import join_chains


def plan_roads(
    curves: Sequence[LaneCurve],
    nodes: Sequence[LaneNode],
    crossings: Sequence[LaneCrossing],
    kinds: Sequence[Hashable],
    lit: Collection[int] = (),
) -> list[PlannedRoad]:
    """The roads for lanes with these curves.

    Args:
      nodes: none at which several lanes end and several begin.
      kinds: of all lanes; lanes of two kinds share no road.
      lit: lanes with a traffic light; a junction begins where they begin.

    What is left of a lane between a junction and the border of the map is straight if it is short.
    """
    spans = junction_spans(curves, nodes, crossings, lit)
    numbers: dict[int, int] = {}
    roads: list[PlannedRoad] = []
    entered, left = {j for node in nodes for j in node.after}, {i for node in nodes for i in node.before}
    parts: list[list[PlannedRoad]] = []  # roads of each lane in order
    for lane, curve in enumerate(curves):
        parts.append([])
        for start, end, span in _sections(curve.length, spans[lane]):
            whole = start == 0 and end == curve.length
            part = curve if whole else cut_curve(curve, start, end)
            is_first, is_last = start == 0 and lane not in entered, end == curve.length and lane not in left
            if span is None and is_first != is_last:
                part = without_short_bend(part, from_end=is_first)
            road = PlannedRoad(len(roads) + 1, part, lane, start, (lane,))
            if span is not None:
                road.junction = numbers.setdefault(span.junction, len(numbers) + 1)
            roads.append(road)
            if parts[lane] and start > 0:
                _connect(parts[lane][-1], road)
            parts[lane].append(road)
    for node in nodes:
        for i, j in node.pairs:
            _connect(parts[i][-1], parts[j][0])
    return join_chains(roads, kinds, lit)


def _sections(length: float, spans: Sequence[JunctionSpan]) -> list[tuple[float, float, JunctionSpan | None]]:
    """The lane cut into what lies in junctions and what lies between them."""
    sections: list[tuple[float, float, JunctionSpan | None]] = []
    place = 0.0
    for span in spans:
        if span.start > place:
            sections.append((place, span.start, None))
        sections.append((span.start, span.end, span))
        place = span.end
    if place < length:
        sections.append((place, length, None))
    return sections


def _connect(before: PlannedRoad, after: PlannedRoad) -> None:
    """Notes that one road follows the other."""
    if after.junction:
        before.junction_after, after.before = after.junction, before.id
    elif before.junction:
        before.after, after.junction_before = after.id, before.junction
    else:
        before.after, after.before = after.id, before.id
