"""Which part of every lane lies in which junction."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence

from scjax.export.roads.crossings import LaneCrossing
from scjax.export.roads.fork_lengths import fork_lengths
from scjax.export.roads.lane_curves import LaneCurve
from scjax.export.roads.lane_nodes import LaneNode, NodeKind
from scjax.export.traffic import LANE_WIDTH

MAX_WHOLE_LENGTH = 60.0
"""Longest lane that lies in a junction as a whole [m]."""

_MARGIN, _MARGIN_SHARE = 3.0, 0.25  # m and share of a lane outside of junctions at an end without one
_MIN_GAP = 4.0  # m between two junctions on a lane; nearer ones are one


@dataclasses.dataclass
class JunctionSpan:
    """Part of a lane in a junction.

    Attributes:
      start, end: arc lengths [m].
      junction: number of the junction.
    """

    start: float
    end: float
    junction: int


class _Junctions:
    """Numbers of junctions; some become one."""

    def __init__(self):
        self._parent: list[int] = []

    def new(self) -> int:
        self._parent.append(len(self._parent))
        return len(self._parent) - 1

    def root(self, number: int) -> int:
        while self._parent[number] != number:
            number = self._parent[number]
        return number

    def unite(self, a: int, b: int) -> None:
        self._parent[self.root(a)] = self.root(b)


def junction_spans(
    curves: Sequence[LaneCurve], nodes: Sequence[LaneNode], crossings: Sequence[LaneCrossing], lit: Collection[int]
) -> list[list[JunctionSpan]]:
    """The parts of every lane in junctions, in order.

    Args:
      curves: middles of all lanes.
      nodes: none at which several lanes end and several begin.
      lit: lanes that begin in a junction if the lane before does not lie in one.
    """
    junctions, lengths = _Junctions(), [curve.length for curve in curves]
    heads, tails = fork_lengths(curves, nodes)
    starts: dict[int, tuple[LaneNode, int]] = {}
    ends: dict[int, tuple[LaneNode, int]] = {}
    for node in nodes:
        number = junctions.new()
        starts |= {j: (node, number) for j in node.after}
        ends |= {i: (node, number) for i in node.before}
    on_lane: dict[int, list[tuple[float, float, int]]] = {}
    for crossing in crossings:
        number = junctions.new()
        for lane, arc in zip(crossing.lanes, crossing.arcs, strict=True):
            on_lane.setdefault(lane, []).append((arc, LANE_WIDTH / 2 + LANE_WIDTH / 2 / crossing.sine, number))
    whole = _whole_lanes(lengths, starts, ends, set(on_lane))
    spans = []
    for lane, length in enumerate(lengths):
        if lane in whole:
            span = JunctionSpan(0.0, length, junctions.new())
            for place, kind in ((starts.get(lane), NodeKind.FORK), (ends.get(lane), NodeKind.MERGE)):
                if place is not None and place[0].kind is kind:
                    junctions.unite(span.junction, place[1])
            for *_, number in on_lane.get(lane, ()):
                junctions.unite(span.junction, number)
            spans.append([span])
        else:
            place = starts.get(lane)
            begins = place is not None and (
                place[0].kind is NodeKind.FORK
                or (place[0].kind is NodeKind.PLAIN and lane in lit and place[0].before[0] not in whole)
            )
            at_start = (place[1], heads[lane]) if place is not None and begins else None
            place = ends.get(lane)
            at_end = (place[1], tails[lane]) if place is not None and place[0].kind is NodeKind.MERGE else None
            spans.append(_lane_spans(length, at_start, at_end, on_lane.get(lane, ()), junctions))
    for row in spans:
        for span in row:
            span.junction = junctions.root(span.junction)
    return spans


def _whole_lanes(
    lengths: Sequence[float],
    starts: dict[int, tuple[LaneNode, int]],
    ends: dict[int, tuple[LaneNode, int]],
    crossed: set[int],
) -> set[int]:
    """Lanes that lie in a junction as a whole: from a fork or a lane outside to a merge or a lane outside."""
    whole: set[int] = set()

    def kind(places: dict[int, tuple[LaneNode, int]], lane: int) -> NodeKind | None:
        return places[lane][0].kind if lane in places else None

    def outside(lane: int) -> bool:
        """Whether the lanes before and after, where nothing forks or merges, do not lie in a junction."""
        beside = []
        if kind(starts, lane) is NodeKind.PLAIN:
            beside.append(starts[lane][0].before[0])
        if kind(ends, lane) is NodeKind.PLAIN:
            beside.append(ends[lane][0].after[0])
        return not whole & set(beside)

    orders = [
        (NodeKind.FORK, NodeKind.MERGE),
        (NodeKind.FORK, NodeKind.PLAIN),
        (NodeKind.PLAIN, NodeKind.MERGE),
        (NodeKind.PLAIN, NodeKind.PLAIN),
    ]
    for order in orders:
        for lane, length in enumerate(lengths):
            if (kind(starts, lane), kind(ends, lane)) == order and length <= MAX_WHOLE_LENGTH and outside(lane):
                if order[0] is not NodeKind.PLAIN or order[1] is not NodeKind.PLAIN or lane in crossed:
                    whole.add(lane)
    return whole


def _lane_spans(
    length: float,
    start: tuple[int, float] | None,
    end: tuple[int, float] | None,
    crossings: Sequence[tuple[float, float, int]],
    junctions: _Junctions,
) -> list[JunctionSpan]:
    """The spans of a lane of which some part stays outside of junctions.

    Args:
      start, end: junction and length [m] of the parts at both ends that lie in one; None if they do not.
    """
    most = length / 3 if start is not None and end is not None else length / 2
    head, tail = start is not None, end is not None
    spans: list[JunctionSpan] = []
    if start is not None:
        spans.append(JunctionSpan(0.0, min(start[1], most), start[0]))
    if end is not None:
        spans.append(JunctionSpan(length - min(end[1], most), length, end[0]))
    margin = min(_MARGIN, _MARGIN_SHARE * length)
    low, high = 0.0 if head else margin, length if tail else length - margin
    middle = length / 2
    for arc, half, number in crossings:
        first, last = max(arc - half, low), min(arc + half, high)
        if head and tail:  # something between stays outside
            gap = min(1.0, 0.1 * length)
            first, last = (first, min(last, middle - gap)) if arc < middle else (max(first, middle + gap), last)
        if last - first > 0.5:
            spans.append(JunctionSpan(first, last, number))
    return _merged(sorted(spans, key=lambda span: span.start), middle if head and tail else None, junctions)


def _merged(spans: list[JunctionSpan], middle: float | None, junctions: _Junctions) -> list[JunctionSpan]:
    """Spans of which none are near each other; of two that are, the junctions become one.

    Args:
      middle: place that stays outside [m]; None if there is none.
    """
    merged: list[JunctionSpan] = []
    for span in spans:
        last = merged[-1] if merged else None
        across = last is not None and middle is not None and last.end < middle < span.start
        if last is None or across or span.start - last.end > _MIN_GAP:
            merged.append(span)
            continue
        junctions.unite(last.junction, span.junction)
        last.end = max(last.end, span.end)
    return merged
