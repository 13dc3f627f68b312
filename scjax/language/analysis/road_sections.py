"""Lanes beside the ego's way: how many with it and against it, and where its approach has lanes for turns only."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence

import numpy as np

from scjax.language.analysis.crossings import MAX_LEVEL
from scjax.language.analysis.crossroads import Crossroad
from scjax.language.analysis.ego_route import EgoRoute
from scjax.language.analysis.lane_lines import LaneLines
from scjax.language.analysis.rings import Ring
from scjax.scene.angles import wrap_to_pi

_PLACES = (0, 3, -3, 6, -6, 9, -9, 12, -12, 16, -16, 20, -20, 24, -24, 28, -28)  # m along the way
_NUM_PLACES = 3
_JUNCTION_MARGIN = 2.0  # m around a junction without sections
_PARALLEL = np.deg2rad(30.0)
_ONE_LANE = 1.8  # m, closer lines are one lane
_SHARED_LANE = 1.0  # m between opposite lines of one lane
_MAX_SPACING, _MAX_SPACING_OPPOSITE = 6.0, 24.0  # m to the next lane of the same direction, of the other one
_MEDIAN_SPACING = 5.5  # m between the directions: 2 m beside a lane of 3.5 m
_TURN = np.deg2rad(35.0)  # of a way that turns off
_TURN_REACH = 30.0  # m behind the approach, where ways are compared
_MAX_WAYS = 16


@dataclasses.dataclass(frozen=True)
class RoadSection:
    """Lanes across the ego's road in one place.

    Attributes:
      same, opposite: distances to the left of the ego's way, of lanes with it and against it, from left to right [m].
      index: the ego's lane among ``same``, from 0 on the left.
      median: whether more than 2 m lie between the directions.
    """

    same: tuple[float, ...]
    opposite: tuple[float, ...]
    index: int
    median: bool


def ego_section(lines: LaneLines, route: EgoRoute, crossroads: Sequence[Crossroad], ring: Ring | None) -> RoadSection:
    """The most frequent of the first three sections outside junctions; of equals, the one nearest to the ego."""
    sections = []
    for along in _PLACES:
        if not route.along[0] <= along <= route.along[-1]:
            continue
        pose = route.pose(float(along))
        if any(_inside(pose, item.center, item.radius) for item in crossroads):
            continue
        if ring is not None and _inside(pose, ring.center, ring.radius):
            continue
        sections.append(_section(lines, pose))
        if len(sections) == _NUM_PLACES:
            break
    if not sections:
        return _section(lines, route.pose(0.0))
    shapes = [(len(section.same), len(section.opposite)) for section in sections]
    shape, _ = Counter(shapes).most_common(1)[0]
    return sections[shapes.index(shape)]


def _inside(pose: np.ndarray, center: np.ndarray, radius: float) -> bool:
    return float(np.hypot(*(pose[:2] - center))) < radius + _JUNCTION_MARGIN


def lanes_across(lines: LaneLines, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Lanes on the line across ``pose`` (x, y, z, heading) at its height.

    Returns:
      Lane, point, distance to the left of the pose [m], and absolute angle [rad] of each.
    """
    cos, sin = np.cos(pose[3]), np.sin(pose[3])
    offset = lines.points[..., :2] - pose[:2]
    forward = cos * offset[..., 0] + sin * offset[..., 1]
    left = cos * offset[..., 1] - sin * offset[..., 0]
    crosses = (forward[:, :-1] * forward[:, 1:] <= 0) & (forward[:, :-1] != forward[:, 1:])
    lane, point = np.nonzero(crosses & lines.real[:, 1:])
    before, after = forward[lane, point], forward[lane, point + 1]
    share = before / (before - after)
    lateral = left[lane, point] + share * (left[lane, point + 1] - left[lane, point])
    angle = np.abs(wrap_to_pi(lines.headings[lane, point] - pose[3]))
    level = np.abs(lines.points[lane, point, 2] - pose[2]) < MAX_LEVEL
    return lane[level], point[level], lateral[level], angle[level]


def _section(lines: LaneLines, pose: np.ndarray) -> RoadSection:
    _, _, lateral, angle = lanes_across(lines, pose)
    same = _distinct([0.0, *lateral[angle < _PARALLEL]])
    opposite = _distinct(list(lateral[angle > np.pi - _PARALLEL]))
    marks = sorted([(x, True) for x in same] + [(x, False) for x in opposite], reverse=True)
    ego = marks.index((0.0, True))
    road, median = [ego], False
    # Oncoming lanes lie on one side: the one where they are nearer.
    nearest = min(opposite, key=abs, default=0.0)
    for sign, side in ((1, range(ego - 1, -1, -1)), (-1, range(ego + 1, len(marks)))):
        last, changed = ego, False
        for k in side:
            spacing, changes = abs(marks[k][0] - marks[last][0]), marks[k][1] != marks[last][1]
            if changes and changed and spacing < _SHARED_LANE:
                continue  # maps draw a lane for turns of both directions once per direction
            if spacing > (_MAX_SPACING_OPPOSITE if changes else _MAX_SPACING) or (changes and changed):
                break
            if changes and sign * nearest < 0:
                break
            changed |= changes
            median |= changes and spacing > _MEDIAN_SPACING
            last = k
            road.append(k)
    lanes = [marks[k] for k in sorted(road)]
    with_ego = tuple(x for x, is_same in lanes if is_same)
    return RoadSection(with_ego, tuple(x for x, is_same in lanes if not is_same), with_ego.index(0.0), median)


def _distinct(offsets: list[float]) -> list[float]:
    """Offsets without those closer than 1.8 m to one that is nearer to the way."""
    kept: list[float] = []
    for value in sorted(map(float, offsets), key=abs):
        if all(abs(value - other) >= _ONE_LANE for other in kept):
            kept.append(value)
    return kept


def approach_turns(lines: LaneLines, route: EgoRoute, crossroads: Sequence[Crossroad]) -> tuple[str, ...]:
    """Directions of lanes on the ego's approach that lead to nothing but a turn, where others go elsewhere."""
    entry = _entry(route, crossroads)
    if entry is None:
        return ()
    pose = route.pose(entry)
    lane, point, lateral, angle = lanes_across(lines, pose)
    parallel = (angle < _PARALLEL) & (np.abs(lateral) < 4 * _MAX_SPACING)
    rows = np.flatnonzero(parallel)
    rows = rows[np.argsort(lateral[rows])]
    groups: list[list[int]] = []
    for row in rows:
        if groups and lateral[row] - lateral[groups[-1][0]] < _ONE_LANE:
            groups[-1].append(int(row))
        else:
            groups.append([int(row)])
    if len(groups) < 2:
        return ()
    turns = [[t for k in group for t in _turns(lines, int(lane[k]), int(point[k]), pose[3])] for group in groups]
    names = set()
    for turn in turns:
        if turn and min(turn) > _TURN:
            names.add("left")
        if turn and max(turn) < -_TURN:
            names.add("right")
    return tuple(sorted(names))


def _entry(route: EgoRoute, crossroads: Sequence[Crossroad]) -> float | None:
    """Distance along the way just before the next junction ahead [m]; None without one."""
    entries = []
    for item in crossroads:
        distance = np.hypot(*(route.points[:, :2] - item.center).T)
        inside = np.flatnonzero((distance < item.radius + 1.0) & (route.along > -2.0))
        if len(inside):
            entries.append(float(route.along[max(int(inside[0]) - 2, 0)]))
    return min(entries, default=None)


def _turns(lines: LaneLines, lane: int, point: int, heading: float) -> list[float]:
    """Turns of all ways from a lane's point on, relative to ``heading`` [rad]."""
    ways, turns = [(lane, float(lines.length[lane] - point * lines.spacing[lane]), (lane,))], []
    while ways and len(turns) < _MAX_WAYS:
        last, travelled, visited = ways.pop()
        choices = [k for k in lines.next[last] if k not in visited]
        if travelled >= _TURN_REACH or not choices:
            back = max(0.0, travelled - _TURN_REACH)
            end = max(0, int(lines.count[last]) - 1 - round(back / float(lines.spacing[last])))
            if travelled > 8.0:
                turns.append(float(wrap_to_pi(lines.headings[last, end] - heading)))
            continue
        ways += [(k, travelled + float(lines.length[k]), (*visited, k)) for k in choices]
    return turns
