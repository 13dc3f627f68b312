"""A map whose lanes are connected as a car can drive."""

from __future__ import annotations

import dataclasses

from scjax.data.join_options import JoinOptions
from scjax.data.lane_graph import distinct_points
from scjax.data.lane_joins import inferred_joins, recorded_joins
from scjax.scene import Map


def connect_lanes(map: Map) -> Map:
    """``map`` with the connections that a car can drive: of those listed, or where ends meet if none are recorded.

    Connections that contradict the geometry are left out, as in scenes that are cut from the map. So are those of lanes
    of no length, and of lanes that the map lacks.
    """
    points = {row: distinct_points(lane.points) for row, lane in enumerate(map.lanes)}
    rows = [row for row, line in points.items() if len(line) >= 2]
    if not rows:
        return map
    lanes, lines = [map.lanes[row] for row in rows], [points[row] for row in rows]
    joins = recorded_joins(lanes, lines) if map.has_topology else inferred_joins(lines, JoinOptions())
    after: dict[str, list[str]] = {}
    before: dict[str, list[str]] = {}
    for one, other in sorted(joins.pairs):
        after.setdefault(lanes[one].id, []).append(lanes[other].id)
        before.setdefault(lanes[other].id, []).append(lanes[one].id)
    joined = (
        dataclasses.replace(lane, predecessors=tuple(before.get(lane.id, ())), successors=tuple(after.get(lane.id, ())))
        for lane in map.lanes
    )
    return dataclasses.replace(map, lanes=tuple(joined), has_topology=True)
