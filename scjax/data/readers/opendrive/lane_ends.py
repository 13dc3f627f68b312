"""Ends of lanes that follow each other, drawn together where the file leaves them apart."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np

from scjax.data.readers.opendrive.lane_lines import LaneKey, LaneLine
from scjax.data.readers.opendrive.lane_links import Links
from scjax.scene.polyline import cumulative_length, smoothstep

MAX_GAP = 0.3  # m; ends farther apart are not meant to meet
_LEAST_REACH, _REACH = 3.0, 20.0  # m along a lane, and for each meter of a gap
_FORK_REACH = 10.0  # m along a lane for each meter
_STEP, _SMALL_SHIFT = 1.5, 0.01  # m between points where a lane is moved by more

_End = tuple[LaneKey, bool]  # a lane, and whether its last point is meant


def close_gaps(lines: dict[LaneKey, LaneLine], pairs: Links) -> None:
    """Moves ends that are linked and up to 0.3 m apart to one place, and the lane before it less and less.

    Ends of roads count more than those of ways through junctions.
    """
    for place in _groups(lines, pairs):
        points = np.stack([_point(lines, end) for end in place])
        outside = np.array([not lines[key].in_junction for key, _ in place])
        target = points[outside].mean(0) if outside.any() else points.mean(0)
        for end, point in zip(place, points, strict=True):
            if 0 < np.linalg.norm(target - point) <= MAX_GAP:
                lines[end[0]] = _moved(lines[end[0]], end[1], target - point, _REACH)


def join_forks(lines: dict[LaneKey, LaneLine], pairs: Links) -> None:
    """Joins lanes that the file links side by side, where it has one lane part into two, or two make one.

    Either the wider lane holds the narrower one between its borders, or both are lanes of one road and neighbors. The
    end that is linked to no other moves to the end of the other lane; of two such ends that of the narrower lane.
    """
    links = Counter(end for a, b in pairs for end in ((a, True), (b, False)))
    for a, b in sorted(pairs):
        ends: list[_End] = sorted([(a, True), (b, False)], key=lambda end: (links[end], _width(lines, end)))
        moving, fixed = (_point(lines, end) for end in ends)
        widths = [_width(lines, end) for end in ends]
        reach = sum(widths) / 2 + MAX_GAP if a.road == b.road else max(widths) / 2
        if MAX_GAP < np.linalg.norm(fixed - moving) <= reach and links[ends[0]] == 1:
            lines[ends[0][0]] = _moved(lines[ends[0][0]], ends[0][1], fixed - moving, _FORK_REACH)


def _groups(lines: dict[LaneKey, LaneLine], pairs: Links) -> list[list[_End]]:
    """Ends that belong to one place."""
    parent: dict[_End, _End] = {}

    def root(end: _End) -> _End:
        while parent.setdefault(end, end) != end:
            parent[end] = parent[parent[end]]
            end = parent[end]
        return end

    for a, b in pairs:
        if np.linalg.norm(_point(lines, (a, True)) - _point(lines, (b, False))) <= MAX_GAP:
            parent[root((a, True))] = root((b, False))
    groups: dict[_End, list[_End]] = {}
    for end in sorted(parent):
        groups.setdefault(root(end), []).append(end)
    return list(groups.values())


def _point(lines: dict[LaneKey, LaneLine], end: _End) -> np.ndarray:
    return lines[end[0]].points[-1 if end[1] else 0]


def _width(lines: dict[LaneKey, LaneLine], end: _End) -> float:
    return float(lines[end[0]].widths[-1 if end[1] else 0])


def _moved(line: LaneLine, is_end: bool, shift: np.ndarray, reach: float) -> LaneLine:
    """A lane with one end moved by ``shift`` [m], over ``reach`` m along it for each meter; its other end stays."""
    order = slice(None, None, -1 if is_end else 1)
    table = np.column_stack([line.points, line.widths])[order]
    arc = cumulative_length(table)
    length = min(max(_LEAST_REACH, reach * float(np.linalg.norm(shift))), float(arc[-1]))
    if np.linalg.norm(shift) > _SMALL_SHIFT:
        parts = np.where(arc[:-1] < length, np.ceil(np.diff(arc) / _STEP), 1).astype(int)
        places = np.append(np.repeat(arc[:-1], parts) + _fractions(parts) * np.repeat(np.diff(arc), parts), arc[-1])
        table = np.stack([np.interp(places, arc, column) for column in table.T], -1)
        arc = places
    table[:, :3] += smoothstep(1 - arc / max(length, 1e-9))[:, None] * shift
    table = table[order]
    return dataclasses.replace(line, points=table[:, :3].copy(), widths=table[:, 3].copy())


def _fractions(parts: np.ndarray) -> np.ndarray:
    """0, 1/n, 2/n ... for every n of ``parts``, in a row."""
    start = np.repeat(np.cumsum(parts) - parts, parts)
    return (np.arange(len(start)) - start) / np.repeat(parts, parts)
