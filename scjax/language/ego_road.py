"""The road that the ego drives on: its lane and path, its cross-section, curves, forks and merges."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from scjax.language.intersections import Intersection
from scjax.language.road import Road, wrap_to_pi
from scjax.language.turn_lanes import Movement, movement

RoadChange = Literal["lane added", "lane ends", "split", "merge", "side road", "junction at the edge"]
Curve = Literal["straight", "gently left", "gently right", "left", "right", "winding"]

# Choice of the ego's lane.
_MAX_LANE_DISTANCE = 2.5  # m
_MAX_LANE_ANGLE = np.deg2rad(45.0)
_ANGLE_COST, _BEND_COST = 2.0, 0.4  # m per rad

_PATH_LENGTH = 40.0  # m of the ego's path, ahead and behind

# Shape of the path; headings are those of chords over 6 m.
_CURVE_REACH = 30  # m
_MIN_CURVE_POINTS = 12
_MAX_WINDING_TURN, _MIN_WINDING_RANGE = 15.0, 0.35  # degrees of net turn, rad between the extreme headings
_CURVE_TURN, _GENTLE_TURN = 20.0, 8.0  # degrees

# Forks and merges.
_JUNCTION_MARGIN = 6.0  # m around an intersection without forks and merges of their own
_MAX_ROAD_LATERAL = 15.0  # m to the side of the ego
_COMPARISON_DISTANCE = 12.0  # m from a fork where its branches are compared
_PARALLEL_ANGLE = 0.3  # rad, branches with less are neighboring lanes
_SIDE_ROAD_TURN = 1.0  # rad
_EDGE_DISTANCE = 18.0  # m from the ego, beyond which a junction is at the edge of view

_OPTION_TURN = np.deg2rad(35.0)  # turn of a branch that is not straight

# Cross-sections.
_SECTION_POSITIONS = (0.0, 6.0, -6.0, 12.0, -12.0, 18.0, -18.0, 24.0, -24.0)  # m along the path
_NUM_SECTIONS = 3
_SAME_DIRECTION = np.deg2rad(30.0)
_MIN_LANE_SPACING = 1.8  # m, closer centerlines count as one lane
_SHARED_LANE_DISTANCE = 1.0  # m between opposite centerlines of one center turn lane
_MAX_SPACING_SAME, _MAX_SPACING_OPPOSITE = 6.0, 14.0  # m to the next lane of the road
_MEDIAN_SPACING = 6.0  # m between the two directions


@dataclasses.dataclass(frozen=True)
class CrossSection:
    """Lanes of the ego's road.

    Attributes:
      lanes_same: in the ego's direction, its lane included.
      lanes_opposite: in the other direction.
      lane_index: the ego's lane, counted from the left, first is 1.
      center_turn_lane: a lane for turns of both directions.
      median: the two directions are apart.
    """

    lanes_same: int
    lanes_opposite: int
    lane_index: int
    center_turn_lane: bool
    median: bool


def ego_lane(road: Road) -> int | None:
    """The lane of the ego, which is at the origin facing +x; None where it is on no lane."""
    if not len(road):
        return None
    point_distances = np.linalg.norm(road.points, axis=-1)
    point, lanes = point_distances.argmin(1), np.arange(len(road))
    distance = point_distances[lanes, point]
    angle = np.abs(wrap_to_pi(road.headings[lanes, np.minimum(point, road.headings.shape[1] - 1)]))
    # The turn of the whole lane prefers the straight lane where branches overlap.
    cost = distance + _ANGLE_COST * angle + _BEND_COST * np.abs(road.bends).sum(1)
    cost[(distance > _MAX_LANE_DISTANCE) | (angle > _MAX_LANE_ANGLE)] = np.inf
    return int(cost.argmin()) if np.isfinite(cost.min()) else None


def ego_path(road: Road, lane: int) -> np.ndarray:
    """The ego's lane, extended by its straightest successors and predecessors.

    Returns:
      Points [n, 2] at a distance of 1 m along the path, at most 40 m behind to 40 m ahead of the ego.
    """
    line = road.points[lane]
    for is_ahead in (True, False):
        last, visited = lane, {lane}
        while np.linalg.norm(np.diff(line, axis=0), axis=-1).sum() < 4 * _PATH_LENGTH:
            choices = [k for k in (road.successors if is_ahead else road.predecessors)[last] if k not in visited]
            if not choices:
                break
            last = min(choices, key=lambda k: abs(road.turn[k]))
            visited.add(last)
            line = np.concatenate([line, road.points[last]] if is_ahead else [road.points[last], line])
    step = np.linalg.norm(np.diff(line, axis=0), axis=-1)
    line = line[np.concatenate([[True], step > 1e-6])]  # lanes share their end points
    arc = np.concatenate([[0], np.cumsum(step[step > 1e-6])])
    ego = arc[np.linalg.norm(line, axis=-1).argmin()]
    positions = np.arange(max(-_PATH_LENGTH, np.ceil(arc[0] - ego)), min(_PATH_LENGTH, arc[-1] - ego) + 0.5)
    return np.stack([np.interp(positions + ego, arc, line[:, k]) for k in (0, 1)], -1)


def cross_section(road: Road, path: np.ndarray, intersections: list[Intersection]) -> CrossSection:
    """The median of the first three sections across the path [n, 2] that lie in no intersection."""
    ego = int(np.linalg.norm(path, axis=-1).argmin())
    sections = []
    for position in _SECTION_POSITIONS:
        point = ego + round(position)
        if not 0 < point < len(path) - 1 or any(
            np.linalg.norm(path[point] - item.center) < item.radius for item in intersections
        ):
            continue
        sections.append(_section_at(road, path[point], path[point + 1] - path[point - 1]))
        if len(sections) == _NUM_SECTIONS:
            break
    if not sections:
        sections = [_section_at(road, path[ego], path[min(ego + 1, len(path) - 1)] - path[max(ego - 1, 0)])]
    median = sorted(sections, key=lambda section: (section.lanes_same, section.lanes_opposite))[len(sections) // 2]
    opposite = int(np.median([section.lanes_opposite for section in sections]))
    return dataclasses.replace(median, lanes_opposite=opposite)


def curve(path: np.ndarray, intersections: list[Intersection]) -> Curve:
    """Shape of the path [n, 2] within 30 m, up to the next intersection."""
    ego = int(np.linalg.norm(path, axis=-1).argmin())
    low, high = max(ego - _CURVE_REACH, 0), min(ego + _CURVE_REACH + 1, len(path))
    for item in intersections:
        inside = np.flatnonzero(np.linalg.norm(path - item.center, axis=-1) < item.radius)
        high = min([high, *inside[inside >= ego]])
        low = max([low, *(inside[inside < ego] + 1)])
    stretch = path[low:high]
    if len(stretch) < _MIN_CURVE_POINTS:
        return "straight"
    step = stretch[3:] - stretch[:-3]
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    net_turn = np.rad2deg(heading[-1] - heading[0])
    if abs(net_turn) <= _MAX_WINDING_TURN and np.ptp(heading) > _MIN_WINDING_RANGE:
        return "winding"
    if abs(net_turn) > _CURVE_TURN:
        return "left" if net_turn > 0 else "right"
    if abs(net_turn) > _GENTLE_TURN:
        return "gently left" if net_turn > 0 else "gently right"
    return "straight"


def road_changes(road: Road, lane: int, intersections: list[Intersection]) -> set[RoadChange]:
    """Types of forks and merges outside intersections, on the road of ``lane`` or close to the ego's axis."""
    connected = road.connected_lanes(lane)
    changes: set[RoadChange] = set()
    for k in range(len(road)):
        for is_fork, branches in ((True, road.successors[k]), (False, road.predecessors[k])):
            if len(branches) < 2:
                continue
            position = road.points[k, -1 if is_fork else 0]
            if any(np.linalg.norm(position - item.center) < item.radius + _JUNCTION_MARGIN for item in intersections):
                continue
            if k in connected or abs(position[1]) < _MAX_ROAD_LATERAL:
                changes.add(_classify_change(road, branches, is_fork, position))
    return changes


def ego_options(road: Road, lane: int, max_distance: float = 60.0) -> set[Movement]:
    """Movements of the ego at the next fork ahead; empty without a fork within ``max_distance`` [m]."""
    distance, last, visited = -road.length[lane] / 2, lane, {lane}
    while distance < max_distance:
        successors = [k for k in road.successors[last] if k not in visited]
        if len(successors) > 1:
            return {movement(float(road.turn[k]), _OPTION_TURN) for k in successors}
        if not successors:
            return set()
        last = successors[0]
        visited.add(last)
        distance += road.length[last]
    return set()


def _classify_change(road: Road, branches: list[int], is_fork: bool, position: np.ndarray) -> RoadChange:
    """Compares the straightest branch with the one that differs most, some meters from the fork or merge."""
    angles = []
    last = road.points.shape[1] - 1
    for branch in branches:
        steps = min(last, max(1, round(_COMPARISON_DISTANCE / max(road.length[branch], 1e-6) * last)))
        line = road.points[branch]
        chord = line[steps] - line[0] if is_fork else line[-1] - line[last - steps]
        angles.append(float(np.arctan2(chord[1], chord[0])))
    main = min(range(len(branches)), key=lambda k: abs(road.turn[branches[k]]))
    other = max(range(len(branches)), key=lambda k: abs(wrap_to_pi(angles[k] - angles[main])))
    angle = abs(wrap_to_pi(angles[other] - angles[main]))
    if abs(road.turn[branches[other]]) > _SIDE_ROAD_TURN:
        return "side road"
    is_cut = road.length[branches].min() < _COMPARISON_DISTANCE / 2
    if np.linalg.norm(position) > _EDGE_DISTANCE and (angle >= _PARALLEL_ANGLE or is_cut):
        return "junction at the edge"
    if angle < _PARALLEL_ANGLE:
        return "lane added" if is_fork else "lane ends"
    return "split" if is_fork else "merge"


def _section_at(road: Road, position: np.ndarray, direction: np.ndarray) -> CrossSection:
    """Lanes on a perpendicular to ``direction`` through ``position``, outwards until the road ends."""
    same, opposite, shared = _lane_offsets(road, position, direction)
    marks = sorted([(x, "same") for x in same] + [(y, "opposite") for y in opposite] + [(x, "turn") for x in shared])
    if not same:
        return CrossSection(1, 0, 1, bool(shared), False)
    start = min((k for k, (_, use) in enumerate(marks) if use == "same"), key=lambda k: abs(marks[k][0]))
    on_road, median = [start], False
    for step in (1, -1):
        k = start
        while 0 <= k + step < len(marks):
            spacing = abs(marks[k + step][0] - marks[k][0])
            use_changes = marks[k + step][1] != marks[k][1]
            if spacing > (_MAX_SPACING_OPPOSITE if use_changes else _MAX_SPACING_SAME):
                break
            median |= use_changes and spacing > _MEDIAN_SPACING
            k += step
            on_road.append(k)
    uses = [marks[k][1] for k in on_road]
    lanes_to_left = sum(marks[k][1] == "same" and marks[k][0] > marks[start][0] for k in on_road)
    return CrossSection(uses.count("same"), uses.count("opposite"), 1 + lanes_to_left, "turn" in uses, median)


def _lane_offsets(
    road: Road, position: np.ndarray, direction: np.ndarray
) -> tuple[list[float], list[float], list[float]]:
    """Offsets to the left of ``position`` [m]: lanes along ``direction``, lanes against it, center turn lanes."""
    ahead = direction / np.linalg.norm(direction)
    left = np.array([-ahead[1], ahead[0]])
    offset = (road.points - position) @ np.stack([ahead, left], -1)
    crosses = offset[:, :-1, 0] * offset[:, 1:, 0] <= 0
    lane, segment = np.nonzero(crosses & (np.abs(offset[:, 1:, 0] - offset[:, :-1, 0]) > 1e-9))
    first, last = offset[lane, segment], offset[lane, segment + 1]
    lateral = first[:, 1] + (last[:, 1] - first[:, 1]) * first[:, 0] / (first[:, 0] - last[:, 0])
    angle = np.abs(wrap_to_pi(road.headings[lane, segment] - np.arctan2(ahead[1], ahead[0])))
    same = _merge_close(lateral[angle < _SAME_DIRECTION])
    opposite = _merge_close(lateral[angle > np.pi - _SAME_DIRECTION])
    # Maps draw a center turn lane once per direction.
    shared = [
        x for x in same if any(abs(x - y) < _SHARED_LANE_DISTANCE for y in opposite) and abs(x) > _MIN_LANE_SPACING / 2
    ]
    same = [x for x in same if x not in shared]
    opposite = [y for y in opposite if all(abs(x - y) >= _SHARED_LANE_DISTANCE for x in shared)]
    return same, opposite, shared


def _merge_close(offsets: np.ndarray) -> list[float]:
    """Offsets without those that are closer than 1.8 m to one nearer to zero."""
    merged: list[float] = []
    for value in sorted(offsets.tolist(), key=abs):
        if all(abs(value - other) >= _MIN_LANE_SPACING for other in merged):
            merged.append(value)
    return merged
