"""Bends that bring new lanes to the ends that they continue, in place and direction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from scjax.outpainting.coverage import OpenEnd, outward_heading
from scjax.scene.polyline import cumulative_length

_LENGTH, _PER_GAP, _PER_TURN = 8.0, 4.0, 12.0  # m of new lanes that bend; more for each m of a gap and each rad
_STEP, _LEAST_STEP = 0.25, 0.05  # m between points of a bend, and at least


class Joint(NamedTuple):
    """A new lane, one end of it, and the open end that it continues."""

    lane: int
    at_start: bool
    open_end: OpenEnd


class _Bend(NamedTuple):
    """A shift of a lane: a cubic of the distance from one of its ends, zero from ``length`` [m] on."""

    lane: int
    at_start: bool
    length: float
    shift: Float64[np.ndarray, " 3"]
    slope: Float64[np.ndarray, " 3"]

    def at(self, distance: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        u = np.clip(distance / self.length, 0.0, 1.0)[:, None]
        return (2 * u**3 - 3 * u**2 + 1) * self.shift + (u**3 - 2 * u**2 + u) * self.length * self.slope

    def slope_at(self, distance: float) -> Float64[np.ndarray, " 3"]:
        u = min(distance / self.length, 1.0)
        return (6 * u**2 - 6 * u) / self.length * self.shift + (3 * u**2 - 4 * u + 1) * self.slope


def bend_lanes(
    lines: Sequence[Float64[np.ndarray, "_ 3"]], edges: Sequence[tuple[int, int]], joints: Sequence[Joint]
) -> list[Float64[np.ndarray, "_ 3"]]:
    """Lines that meet the open ends of their joints without a gap or a change of direction.

    The shift fades over 8 m, more for a wide gap or a turn. It goes on along connected lanes, so that they stay
    connected, but not beyond another joint. Of joints at one place the first counts.

    Args:
      edges: pairs of lines, the second of which begins where the first one ends.
    """
    lanes = _Connected(lines, edges)
    fixed = {lanes.node(joint.lane, joint.at_start) for joint in joints}
    first = {lanes.node(joint.lane, joint.at_start): joint for joint in reversed(joints)}
    bends = [bend for joint in first.values() for bend in lanes.bends_of(joint, fixed)]
    return [_shifted(line, [bend for bend in bends if bend.lane == row]) for row, line in enumerate(lines)]


class _Connected:
    """Lines and which of their ends are one place."""

    def __init__(self, lines: Sequence[np.ndarray], edges: Sequence[tuple[int, int]]):
        self._lines = lines
        self._lengths = [float(cumulative_length(line)[-1]) for line in lines]
        ends, starts = np.array([(2 * a + 1, 2 * b) for a, b in edges], int).reshape(-1, 2).T
        graph = coo_matrix((np.ones(len(ends)), (ends, starts)), shape=(2 * len(lines),) * 2)
        self._nodes = connected_components(graph, directed=False)[1]

    def node(self, lane: int, at_start: bool) -> int:
        return int(self._nodes[2 * lane + (not at_start)])

    def bends_of(self, joint: Joint, fixed: set[int]) -> list[_Bend]:
        """The bends of all lines that one joint moves."""
        line, end = self._lines[joint.lane], joint.open_end
        shift = np.nan_to_num(end.place - line[0 if joint.at_start else -1])
        slope = _direction(end.outward) + _direction(outward_heading(line, joint.at_start) or 0.0)
        length = _LENGTH + float(_PER_GAP * np.hypot(*shift[:2]) + _PER_TURN * np.hypot(*slope[:2]))
        node = self.node(joint.lane, joint.at_start)
        first = _Bend(joint.lane, joint.at_start, length, shift, slope)
        reach = min((way for way, at in self._reached(first, node) if at in fixed - {node}), default=length)
        first = first._replace(length=min(length, max(reach, _STEP)))
        queue, bends = [first, *self._beside(first)], {}
        while queue:
            bend = queue.pop()
            if bend.lane not in bends:
                bends[bend.lane] = bend
                if self._lengths[bend.lane] < bend.length:
                    queue += self._beyond(bend)
        return list(bends.values())

    def _reached(self, first: _Bend, node: int) -> Iterator[tuple[float, int]]:
        """Distances along lines from a joint, at ``node``, to places within its bend, and those; nearest first."""
        passed = {node}
        queue = [(self._lengths[bend.lane], bend) for bend in (first, *self._beside(first))]
        while queue:
            queue.sort(key=lambda item: -item[0])
            way, bend = queue.pop()
            far = self.node(bend.lane, not bend.at_start)
            if way >= first.length or far in passed:
                continue
            passed.add(far)
            yield way, far
            queue += [(way + self._lengths[other.lane], other) for other in self._beyond(bend)]

    def _beside(self, bend: _Bend) -> list[_Bend]:
        """The bends of the other lines at the place where a bend begins."""
        return self._at(self.node(bend.lane, bend.at_start), bend, bend.at_start, bend.length, bend.shift, bend.slope)

    def _beyond(self, bend: _Bend) -> list[_Bend]:
        """The bends that go on where a line ends within its bend."""
        way = self._lengths[bend.lane]
        shift, slope = bend.at(np.array([way]))[0], bend.slope_at(way)
        far = self.node(bend.lane, not bend.at_start)
        return self._at(far, bend, bend.at_start, max(bend.length - way, 1e-6), shift, slope)

    def _at(
        self, node: int, bend: _Bend, at_start: bool, length: float, shift: np.ndarray, slope: np.ndarray
    ) -> list[_Bend]:
        """One bend for each other line at a place; ``slope`` is that of lines that leave it like ``at_start``."""
        return [
            _Bend(row // 2, row % 2 == 0, length, shift, slope if (row % 2 == 0) == at_start else -slope)
            for row in np.flatnonzero(self._nodes == node).tolist()
            if row // 2 != bend.lane
        ]


def _direction(heading: float) -> Float64[np.ndarray, " 3"]:
    return np.array([np.cos(heading), np.sin(heading), 0.0])


def _shifted(line: Float64[np.ndarray, "points 3"], bends: Sequence[_Bend]) -> Float64[np.ndarray, "n 3"]:
    """A line with more points where it bends, and its bends added."""
    if not bends:
        return line
    arc = cumulative_length(line)
    knots = [arc]
    for bend in bends:
        near = np.arange(0.0, min(bend.length, arc[-1]), _STEP)
        knots.append(near if bend.at_start else arc[-1] - near)
    places = np.unique(np.concatenate(knots))
    places = places[np.diff(places, prepend=-1.0) > _LEAST_STEP]
    places = np.append(places[places < arc[-1] - _LEAST_STEP], arc[-1])
    points = np.stack([np.interp(places, arc, column) for column in line.T], -1)
    for bend in bends:
        points += bend.at(places if bend.at_start else arc[-1] - places)
    return points
