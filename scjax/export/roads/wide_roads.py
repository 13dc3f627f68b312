"""Roads of one lane -> roads of all lanes beside each other.

Lanes of one road begin and end on one line across it. At a junction the road ends where the first of its lanes does,
and the ways through the junction get what is cut off from the others. At an open end it ends where the last one does,
and the others go on straight.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from scjax.export.roads.lane_borders import have_usual_widths, joined_lane_borders, lane_arcs
from scjax.export.roads.lane_curves import (
    LaneCurve,
    curve_frames,
    cut_curve,
    fit_curve,
    join_curves,
    part_of_curve,
    reversed_curve,
    with_end_headings,
    with_end_heights,
    without_short_ends,
)
from scjax.export.roads.planned_road import PlannedRoad
from scjax.export.roads.side_by_side import RoadGroup, side_by_side
from scjax.export.roads.wide_road import RoadLane, WideRoad

_LEAST_LENGTH = 3.0  # m of a road with lanes beside each other
_DIRECTION_STEPS = 4  # of 1 m, in which a parabola gives the direction at an end of a road
_MOST_LONGER = 12.0  # m that a lane is made longer at an open end
_LEAST_REST = 1e-3  # m


def wide_roads(roads: Sequence[PlannedRoad], kinds: Sequence[Hashable]) -> list[WideRoad]:
    """The roads, with those side by side as one road; no two lead from one junction to the same other one.

    Args:
      kinds: of all lanes; lanes of two kinds share no road.
    """
    by_id = {road.id: road for road in roads}
    wide: list[WideRoad] = []
    for group in side_by_side(roads, kinds):
        parts = [group, RoadGroup(group.forward, ()), RoadGroup(group.backward[::-1], ())]
        whole = _joined(parts[0], by_id)
        made = [whole] if whole else [_joined(part, by_id) for part in parts[1:] if len(part.forward) > 1]
        wide += [road for road in made if road is not None]
    joined = {lane.road.id: (road, lane) for road in wide for lane in road.lanes}
    for road in roads:
        if road.id not in joined:
            curve = _way(road, joined) if road.junction else without_short_ends(road.curve)
            lane = RoadLane(road, curve, -1, 0.0, road.curve.length)
            before, after = (0, 0) if road.junction else (road.before, road.after)  # of a way: see lane_ends
            ends = (before, after, road.junction_before, road.junction_after)
            wide.append(WideRoad(road.id, curve, (lane,), None, road.junction, *ends))
    return _without_doubles(sorted(wide, key=lambda road: road.id))


def _joined(group: RoadGroup, by_id: dict[int, PlannedRoad]) -> WideRoad | None:
    """The road of a group, along its first one; None if its lanes have no common part, or unusual widths there."""
    first = by_id[group.forward[0]]
    members = [by_id[id] for id in (*group.backward, *group.forward)]
    numbers = [*range(len(group.backward), 0, -1), *range(-1, -1 - len(group.forward), -1)]
    curves = [
        road.curve if number < 0 else reversed_curve(road.curve) for road, number in zip(members, numbers, strict=True)
    ]
    reference = _common_part(first.curve, curves, first)
    middle = None if reference is None else _middle(reference, curves)
    reference = None if middle is None else _common_part(middle, curves, first)
    if reference is None:
        return None
    lanes = []
    for road, curve, number in zip(members, curves, numbers, strict=True):
        arcs = lane_arcs(reference, curve, np.array([0.0, reference.length]))
        if arcs is None or arcs[1] - arcs[0] < _LEAST_LENGTH / 2:
            return None
        kept = arcs if number < 0 else road.curve.length - arcs[::-1]
        lanes.append(RoadLane(road, part_of_curve(curve, *arcs.tolist()), number, *kept.tolist()))
    borders = joined_lane_borders(reference, [lane.curve for lane in lanes])
    if borders is None or not have_usual_widths(borders):
        return None
    ends = (first.junction_before, first.junction_after)
    return WideRoad(first.id, reference, tuple(lanes), borders, 0, 0, 0, *ends)


def _common_part(reference: LaneCurve, curves: Sequence[LaneCurve], first: PlannedRoad) -> LaneCurve | None:
    """The part of a reference line for these lanes, made longer at open ends; None if there is nearly none."""
    starts, ends = (np.array([_station(reference, curve, at_end) for curve in curves]) for at_end in (False, True))
    start = starts.max() if first.junction_before else max(starts.min(), starts.max() - _MOST_LONGER)
    end = ends.min() if first.junction_after else min(ends.max(), ends.min() + _MOST_LONGER)
    if end - start < _LEAST_LENGTH:
        return None
    return without_short_ends(part_of_curve(reference, float(start), float(end)))


def _middle(reference: LaneCurve, curves: Sequence[LaneCurve]) -> LaneCurve | None:
    """The curve halfway between the first and the last lane: single lanes bend more at their ends than roads do."""
    stations = np.linspace(0.0, reference.length, max(int(reference.length), 4) + 1)
    points = []
    for curve in (curves[0], curves[-1]):
        arcs = lane_arcs(reference, curve, stations)
        if arcs is None:
            return None
        points.append(np.column_stack([curve_frames(curve, arcs)[0], np.interp(arcs, *curve.heights.T)]))
    line = np.mean(points, axis=0)
    rows = min(_DIRECTION_STEPS, len(line) - 1) + 1
    parabolas = [np.polyfit(np.arange(rows), part[:, :2], 2) for part in (line[:rows], line[::-1][:rows])]
    start, end = (np.arctan2(slope[1], slope[0]) for _, slope, _ in parabolas)
    return fit_curve(line, float(start), float(end + np.pi))


def _station(reference: LaneCurve, curve: LaneCurve, at_end: bool) -> float:
    """Where on the reference line, or straight beyond its ends, a curve begins or ends [m]."""
    place = curve.pieces[-1, 3] if at_end else curve.pieces[0, 0]
    station = np.array([reference.length if at_end else 0.0])
    for _ in range(20):
        point, heading = curve_frames(reference, station)
        step = (place - point[0]) @ np.array([np.cos(heading[0]), np.sin(heading[0])])
        station = station + step
        if abs(step) < 1e-6:
            break
    return float(station[0])


def _way(road: PlannedRoad, joined: dict[int, tuple[WideRoad, RoadLane]]) -> LaneCurve:
    """A way through a junction, from where the wide road before it ends to where the one after it begins."""
    curve = road.curve
    heights = [float(curve.heights[0, 1]), float(curve.heights[-1, 1])]
    headings: list[float | None] = [None, None]
    if road.before in joined:
        wide, lane = joined[road.before]
        if lane.road.curve.length - lane.end > _LEAST_REST:
            curve = join_curves([cut_curve(lane.road.curve, lane.end, lane.road.curve.length), curve])
        heights[0], headings[0] = _end(wide, lane.number < 0, lane.number)
    if road.after in joined:
        wide, lane = joined[road.after]
        if lane.start > _LEAST_REST:
            curve = join_curves([curve, cut_curve(lane.road.curve, 0.0, lane.start)])
        heights[1], headings[1] = _end(wide, lane.number > 0, lane.number)
    return with_end_heights(with_end_headings(curve, *headings), *heights)


def _end(road: WideRoad, at_end: bool, number: int) -> tuple[float, float]:
    """Height of a road at an end [m], and the direction of a lane's traffic there [rad]."""
    (heading,) = curve_frames(road.curve, np.array([road.curve.length if at_end else 0.0]))[1].tolist()
    return float(road.curve.heights[-1 if at_end else 0, 1]), heading + (np.pi if number > 0 else 0.0)


def _without_doubles(roads: list[WideRoad]) -> list[WideRoad]:
    """The roads, of which no two lead from one junction to the same other one, or back to itself: these are cut in two.

    SUMO has one edge from a node to another.
    """
    pairs: set[tuple[int, int]] = set()
    for road in list(roads):
        ends = (road.junction_before, road.junction_after)
        if road.junction or not all(ends):
            continue
        led = {ends if lane.number < 0 else (ends[1], ends[0]) for lane in road.lanes}
        if ends[0] != ends[1] and not led & pairs:
            pairs |= led
            continue
        rest = _cut_in_two(road, max(other.id for other in roads) + 1)
        roads.append(rest)
    return roads


def _cut_in_two(road: WideRoad, id: int) -> WideRoad:
    """Keeps the first half of a road; returns the other one."""
    length = road.curve.length
    halves = [cut_curve(road.curve, 0.0, length / 2), cut_curve(road.curve, length / 2, length)]
    lanes: list[list[RoadLane]] = [[], []]
    for lane in road.lanes:
        arcs = lane_arcs(road.curve, lane.curve, np.array([length / 2]))
        middle = lane.curve.length / 2 if arcs is None else float(arcs[0])
        place = lane.start + middle if lane.number < 0 else lane.end - middle
        for row, (start, end) in enumerate(((0.0, middle), (middle, lane.curve.length))):
            is_first = (row == 0) == (lane.number < 0)
            bounds = (lane.start, place) if is_first else (place, lane.end)
            lanes[row].append(RoadLane(lane.road, cut_curve(lane.curve, start, end), lane.number, *bounds))
    rest = WideRoad(id, halves[1], tuple(lanes[1]), None, 0, road.id, 0, 0, road.junction_after)
    road.curve, road.lanes, road.after, road.junction_after = halves[0], tuple(lanes[0]), id, 0
    if road.borders is not None:
        for half in (road, rest):
            half.borders = joined_lane_borders(half.curve, [lane.curve for lane in half.lanes])
    return rest
