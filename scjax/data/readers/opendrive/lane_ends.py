"""Ends of lanes that follow each other, drawn together where the file leaves them a little apart."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.data.readers.opendrive.lane_lines import LaneKey, LaneLine
from scjax.data.readers.opendrive.lane_links import Links

MAX_GAP = 0.3  # m; ends farther apart are not meant to meet
_LEAST_REACH, _REACH = 3.0, 20.0  # m along a lane, and for each meter of a gap

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
                lines[end[0]] = _moved(lines[end[0]], end[1], target - point)


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


def _moved(line: LaneLine, is_end: bool, shift: np.ndarray) -> LaneLine:
    """A lane with one end moved by ``shift`` [m]; its other end stays."""
    order = slice(None, None, -1 if is_end else 1)
    points = line.points[order]
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
    length = min(max(_LEAST_REACH, _REACH * float(np.linalg.norm(shift))), float(arc[-1]))
    share = np.clip(1 - arc / max(length, 1e-9), 0.0, 1.0)
    moved = points + (share * share * (3 - 2 * share))[:, None] * shift
    return dataclasses.replace(line, points=moved[order])
