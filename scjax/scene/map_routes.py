"""Routes over a map, and how well lanes meet at seams."""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.scene.angles import wrap_to_pi
from scjax.scene.map import Map, MapRoute, MapSeam
from scjax.scene.polyline import cumulative_length


def find_route(map: Map, first: str, last: str, *, name: str = "") -> MapRoute:
    """The shortest way from the start of lane ``first`` to the end of lane ``last``, along successors only.

    Args:
      name: of the route.

    Raises:
      ValueError: there is no such lane, or no way.
    """
    lanes = map.lane_by_id
    for item in (first, last):
        if item not in lanes:
            raise ValueError(f"the map has no lane {item!r}: give one of its {map.num_lanes} lanes")
    following: dict[str, set[str]] = {
        item: {other for other in lane.successors if other in lanes} for item, lane in lanes.items()
    }
    for item, lane in lanes.items():
        for before in lane.predecessors:
            if before in following:
                following[before].add(item)
    lengths = {item: float(cumulative_length(lane.points)[-1]) for item, lane in lanes.items()}
    queue, best, came_from = [(lengths[first], first)], {first: lengths[first]}, {first: ""}
    while queue:
        distance, item = heapq.heappop(queue)
        if item == last:
            break
        for other in sorted(following[item]) if distance <= best[item] else ():
            total = distance + lengths[other]
            if total < best.get(other, np.inf):
                best[other], came_from[other] = total, item
                heapq.heappush(queue, (total, other))
    if last not in came_from:
        raise ValueError(f"no way leads from lane {first!r} to lane {last!r}: choose others, or connect the lanes")
    way = [last]
    while way[-1] != first:
        way.append(came_from[way[-1]])
    return MapRoute(lane_ids=tuple(reversed(way)), name=name)


def route_line(map: Map, route: MapRoute) -> Float64[np.ndarray, "points 3"]:
    """The centerlines of a route, from its start to its end [m]. A change to a lane beside is a step across."""
    lanes = map.lane_by_id
    last = len(route.lane_ids) - 1
    parts = []
    for number, item in enumerate(route.lane_ids):
        start = route.start if number == 0 else 0.0
        end = np.inf if route.end is None or number < last else route.end
        parts.append(_part(lanes[item].points, start, end))
    return np.concatenate(parts)


def _part(points: np.ndarray, start: float, end: float) -> np.ndarray:
    """The part of a polyline between two arc lengths [m]."""
    arc = cumulative_length(points)
    low, high = np.clip([start, max(end, start)], 0.0, arc[-1])
    inside = points[(arc > low) & (arc < high)]
    ends = np.stack([[np.interp(at, arc, column) for column in points.T] for at in (low, high)])
    return np.concatenate([ends[:1], inside, ends[1:]])


class SeamMeasures(NamedTuple):
    """How well lanes meet at a seam.

    Attributes:
      gaps: distance from the end of each lane to the start of the one that follows [m].
      turns: change of direction there [rad], NaN where a lane has no direction.
    """

    gaps: Float64[np.ndarray, " connections"]
    turns: Float64[np.ndarray, " connections"]


def measure_seam(map: Map, seam: MapSeam) -> SeamMeasures:
    """Gaps and turns of the connections of a seam."""
    lanes = map.lane_by_id
    gaps, turns = np.zeros(len(seam.connections)), np.zeros(len(seam.connections))
    for row, (before, after) in enumerate(seam.connections):
        one, other = lanes[before].points, lanes[after].points
        gaps[row] = np.hypot(*(other[0] - one[-1])[:2])
        turns[row] = abs(wrap_to_pi(_heading(other, 0) - _heading(one, -1)))
    return SeamMeasures(gaps, turns)


def _heading(points: np.ndarray, at: int) -> float:
    """Direction of the first (0) or last (-1) segment that has one [rad]."""
    steps = np.diff(points[:, :2], axis=0)
    steps = steps[np.hypot(*steps.T) > 0]
    return float(np.arctan2(steps[at, 1], steps[at, 0])) if len(steps) else float("nan")
