"""Which roads of one lane are one road: those that lie beside each other from end to end."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np

from scjax.export.roads.lane_curves import curve_line
from scjax.export.roads.planned_road import PlannedRoad

_LEAST_APART, _MOST_APART = 2.5, 5.0  # m between the middles of two lanes beside each other
_STEP = 1.0  # m between the places where they are compared
_ALONG = 0.75  # m along a lane that the place beside is off
_PARALLEL = 0.95  # cosine of the angle between them
_LEAST_SHARED = 4.0  # m that they lie beside each other
_MOST_STAGGERED, _MOST_OBLIQUE = 25.0, 12.0  # m that one begins or ends before another: at a junction, at an open end
_MOST_RISE = 0.3  # m between their heights


class RoadGroup(NamedTuple):
    """Roads that are one.

    Attributes:
      forward: ids of those in the direction of the first one, from left to right.
      backward: ids of those in the other direction, from left to right as seen along the first one.
    """

    forward: tuple[int, ...]
    backward: tuple[int, ...]


class _Line(NamedTuple):
    points: np.ndarray
    ways: np.ndarray


def side_by_side(roads: Sequence[PlannedRoad], kinds: Sequence[Hashable]) -> list[RoadGroup]:
    """Groups of at least two roads: each beside the next, with the same junctions, or nothing, at both ends.

    Two directions are one road where they keep to the right of each other.

    Args:
      kinds: of all lanes; lanes of two kinds share no road.
    """
    free = {road.id: road for road in roads if not (road.junction or road.before or road.after)}
    lines = {id: _line(road) for id, road in free.items()}
    left: dict[int, tuple[float, int]] = {}
    right: dict[int, tuple[float, int]] = {}
    facing: dict[int, tuple[float, int]] = {}
    for a, b in _near(lines):
        if kinds[free[a].lane] != kinds[free[b].lane]:
            continue
        is_same = float((lines[a].ways.mean(0) * lines[b].ways.mean(0)).sum()) > 0
        offset = _offset(free[a], free[b], lines[a], lines[b], is_same)
        if offset is None:
            continue
        side = facing if not is_same else left if offset > 0 else right
        if is_same or offset > 0:
            side[a] = min(side.get(a, (np.inf, 0)), (abs(offset), b))
    after = {a: b for a, (_, b) in right.items() if left.get(b, (0.0, 0))[1] == a}
    chains = {}
    for first in free.keys() - set(after.values()):
        chain = [first]
        while chain[-1] in after:
            chain.append(after[chain[-1]])
        chains[first] = tuple(chain)
    groups, used = [], set()
    for first in sorted(chains):
        other = facing.get(first, (0.0, 0))[1]
        is_pair = other in chains and facing.get(other, (0.0, 0))[1] == first
        if first in used or (len(chains[first]) == 1 and not is_pair):
            continue
        groups.append(RoadGroup(chains[first], chains[other][::-1] if is_pair else ()))
        used |= {first, other} if is_pair else {first}
    return groups


def _line(road: PlannedRoad) -> _Line:
    points = curve_line(road.curve, _STEP)[0]
    ways = np.gradient(points[:, :2], axis=0)
    return _Line(points, ways / np.maximum(np.hypot(*ways.T), 1e-9)[:, None])


def _near(lines: dict[int, _Line]) -> list[tuple[int, int]]:
    """Pairs of lines with a point near one of the other, in both orders."""
    from scipy.spatial import KDTree

    if len(lines) < 2:
        return []
    owner = np.repeat(list(lines), [len(line.points) for line in lines.values()])
    tree = KDTree(np.concatenate([line.points[:, :2] for line in lines.values()]))
    rows = tree.query_pairs(_MOST_APART + _STEP, output_type="ndarray")
    pairs = {(a, b) for a, b in owner[rows].tolist() if a != b}
    return sorted(pairs | {(b, a) for a, b in pairs})


def _offset(a: PlannedRoad, b: PlannedRoad, line: _Line, other: _Line, is_same: bool) -> float | None:
    """How far the middle of ``b`` is to the left of ``a`` on average [m]; None if they cannot be one road."""
    ends = (b.junction_before, b.junction_after) if is_same else (b.junction_after, b.junction_before)
    if (a.junction_before, a.junction_after) != ends:
        return None
    step = other.points[None, :, :] - line.points[:, None, :]
    row = np.hypot(step[..., 0], step[..., 1]).argmin(1)
    step = step[np.arange(len(row)), row]
    along = (step[:, :2] * line.ways).sum(1)
    aside = line.ways[:, 0] * step[:, 1] - line.ways[:, 1] * step[:, 0]
    beside = np.flatnonzero(np.abs(along) <= _ALONG)
    if len(beside) * _STEP < _LEAST_SHARED:
        return None
    first, last = beside[0], beside[-1]
    cosine = (line.ways[first : last + 1] * other.ways[row[first : last + 1]]).sum(1) * (1 if is_same else -1)
    aside, rise = aside[first : last + 1], np.abs(step[first : last + 1, 2])
    apart = np.abs(aside)
    if not (
        (cosine > _PARALLEL).all()
        and (apart > _LEAST_APART).all()
        and (apart < _MOST_APART).all()
        and (np.sign(aside) == np.sign(aside[0])).all()
        and rise.max() < _MOST_RISE
    ):
        return None
    rest = np.array([first, len(line.points) - 1 - last]) * _STEP
    ends_there = np.sort(row[[first, last]])
    rest_there = np.array([ends_there[0], len(other.points) - 1 - ends_there[1]])[:: 1 if is_same else -1] * _STEP
    limits = [_MOST_STAGGERED if junction else _MOST_OBLIQUE for junction in (a.junction_before, a.junction_after)]
    return float(aside.mean()) if (rest + rest_there <= limits).all() else None
