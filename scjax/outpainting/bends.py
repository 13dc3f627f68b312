"""Bends that bring new lanes to the ends that they continue, in place and direction."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.outpainting.coverage import OpenEnd, outward_heading
from scjax.scene.angles import wrap_to_pi
from scjax.scene.polyline import cumulative_length, smoothstep

SAME_PLACE = 0.05
"""m between ends that are one place: what is left of a bend, or of lanes that split or merge."""

MAX_BEND = np.deg2rad(5.0)
"""Change of direction where lanes meet, at most."""

_LENGTH, _PER_GAP, _PER_TURN = 8.0, 4.0, 12.0  # m of new lanes that bend; more for each m of a gap and each rad
_STEP, _LEAST_STEP = 0.25, 0.05  # m between points of a bend, and at least
_SINGULAR = 1e-3  # smaller singular values, as a share of the largest, are left out: joints that almost share a place


class Joint(NamedTuple):
    """A new lane, one end of it, and the open end that it continues."""

    lane: int
    at_start: bool
    open_end: OpenEnd


class _Shift(NamedTuple):
    """How a place moves with a joint.

    Attributes:
      shift: factors of the joint's own shift and slope, which give that of the place [m].
      slope: the same for the change of the shift along the road.
      left: m along the road, after which nothing moves.
    """

    shift: Float64[np.ndarray, " 2"]
    slope: Float64[np.ndarray, " 2"]
    left: float


class Bends:
    """The shifts of lines that bring them to the open ends of their joints without a gap or a change of direction.

    Each joint moves the road around it, by a shift that fades over 8 m, more for a wide gap or a turn. It goes on along
    connected lanes, so that they stay connected and smooth. The shifts of joints near each other add up to what all of
    them need. Of joints at one place the first counts.

    Args:
      edges: pairs of lines, the second of which begins where the first one ends.
      joints: at least one.
    """

    def __init__(
        self,
        lines: Sequence[Float64[np.ndarray, "_ 3"]],
        edges: Sequence[tuple[int, int]],
        joints: Sequence[Joint],
    ):
        self._roads = roads = _Roads(lines, edges)
        first = {roads.node(joint.lane, joint.at_start): joint for joint in reversed(joints)}
        targets = np.stack([_target(lines[joint.lane], joint) for joint in first.values()])
        self._places = {node: joint.open_end.place for node, joint in first.items()}
        self._fields = fields = [roads.spread(node, *target) for node, target in zip(first, targets, strict=True)]
        nothing = _Shift(np.zeros(2), np.zeros(2), 0.0)
        at_joints = [[np.stack(field.get(node, nothing)[:2]) for field in fields] for node in first]
        matrix = np.concatenate([np.concatenate(row, axis=1) for row in at_joints])
        factors = np.linalg.lstsq(matrix, targets.reshape(-1, 3), rcond=_SINGULAR)[0]
        self._factors = factors.reshape(targets.shape)

    def lines(self) -> list[Float64[np.ndarray, "_ 3"]]:
        """The lines where they are moved to, with more points where they bend.

        Ends that are one place are equal bit for bit, and so are the open ends that they meet.
        """
        moved = [self._roads.moved(row, self._fields, self._factors) for row in range(self._roads.num_lines)]
        return self._roads.closed(moved, self._places)

    def shifts(self, line: int, places: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        """How far a line moves at places along it [m]."""
        return self._roads.shifts(line, places, self._fields, self._factors)


def is_met(line: Float64[np.ndarray, "_ 3"], joint: Joint) -> bool:
    """Whether a line begins or ends within 5 cm of its joint, and bends by less than 5 degrees there."""
    heading = outward_heading(line, joint.at_start)
    turn = np.pi if heading is None else abs(wrap_to_pi(heading + np.pi - joint.open_end.outward))
    gap = np.hypot(*(line[0 if joint.at_start else -1] - joint.open_end.place)[:2])
    return bool(gap < SAME_PLACE and turn < MAX_BEND)


def line_to(
    line: Float64[np.ndarray, "points 3"], place: Float64[np.ndarray, " 3"], at_start: bool
) -> Float64[np.ndarray, "points 3"]:
    """A line whose start or end is at a place, moved by less and less over 8 m; its other end and directions stay.

    Args:
      place: x, y, z [m]; where z is NaN, the line's own stays.
    """
    at = 0 if at_start else -1
    place = np.where(np.isnan(place), line[at], place)
    shift = np.nan_to_num(place - line[at])
    if not shift.any():
        return line
    arc = cumulative_length(line)
    share = smoothstep(1.0 - (arc if at_start else arc[-1] - arc) / max(min(_LENGTH, arc[-1]), 1e-9))
    moved = line + share[:, None] * shift
    moved[at, ~np.isnan(line[at])] = place[~np.isnan(line[at])]
    return moved


def _target(line: Float64[np.ndarray, "points 3"], joint: Joint) -> Float64[np.ndarray, "2 3"]:
    """The shift of a line's end to its open end, and the change of its direction there, along the line."""
    end = joint.open_end
    shift = np.nan_to_num(end.place - line[0 if joint.at_start else -1])
    turn = _direction(end.outward) + _direction(outward_heading(line, joint.at_start) or 0.0)
    return np.stack([shift, turn if joint.at_start else -turn])


def _direction(heading: float) -> Float64[np.ndarray, " 3"]:
    return np.array([np.cos(heading), np.sin(heading), 0.0])


def _between(
    places: Float64[np.ndarray, " n"], length: float, start: Sequence[np.ndarray], end: Sequence[np.ndarray]
) -> tuple[Float64[np.ndarray, "n k"], Float64[np.ndarray, "n k"]]:
    """Values and slopes of the cubic with these values and slopes at 0 and ``length``; those of the end beyond it."""
    u = np.clip(places / length, 0.0, 1.0)[:, None]
    values = (2 * u**3 - 3 * u**2 + 1) * start[0] + (u**3 - 2 * u**2 + u) * length * start[1]
    values = values + (3 * u**2 - 2 * u**3) * end[0] + (u**3 - u**2) * length * end[1]
    slopes = (6 * u**2 - 6 * u) / length * (start[0] - end[0])
    return values, slopes + (3 * u**2 - 4 * u + 1) * start[1] + (3 * u**2 - 2 * u) * end[1]


class _Roads:
    """Lines, and which of their ends are one place."""

    def __init__(self, lines: Sequence[np.ndarray], edges: Sequence[tuple[int, int]]):
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        self._lines, self.num_lines = lines, len(lines)
        self._lengths = [float(cumulative_length(line)[-1]) for line in lines]
        ends, starts = np.array([(2 * a + 1, 2 * b) for a, b in edges], int).reshape(-1, 2).T
        graph = coo_matrix((np.ones(len(ends)), (ends, starts)), shape=(2 * len(lines),) * 2)
        self._nodes = connected_components(graph, directed=False)[1].tolist()
        self._ends: dict[int, list[tuple[int, bool]]] = {}
        for row, node in enumerate(self._nodes):
            self._ends.setdefault(node, []).append((row // 2, row % 2 == 0))

    def node(self, lane: int, at_start: bool) -> int:
        return self._nodes[2 * lane + (not at_start)]

    def spread(self, node: int, shift: np.ndarray, slope: np.ndarray) -> dict[int, _Shift]:
        """The shifts of all places that a joint at one of them moves, each along the shortest way."""
        length = _LENGTH + float(_PER_GAP * np.hypot(*shift[:2]) + _PER_TURN * np.hypot(*slope[:2]))
        found = {node: _Shift(np.array([1.0, 0.0]), np.array([0.0, 1.0]), length)}
        queue = [(-length, node)]
        while queue:
            left, at = heapq.heappop(queue)
            here = found[at]
            if -left < here.left:
                continue
            for lane, forward in self._ends[at]:
                far = self.node(lane, not forward)
                left = here.left - self._lengths[lane]
                if left <= 0 or (far in found and found[far].left >= left):
                    continue
                sign = 1.0 if forward else -1.0
                values, slopes = _faded(np.array([self._lengths[lane]]), here, sign)
                found[far] = _Shift(values[0], sign * slopes[0], left)
                heapq.heappush(queue, (-left, far))
        return found

    def closed(
        self, lines: list[Float64[np.ndarray, "_ 3"]], places: Mapping[int, Float64[np.ndarray, " 3"]]
    ) -> list[Float64[np.ndarray, "_ 3"]]:
        """Lines whose ends are exactly at the place of their node, if one is given and close, else at the first end.

        Args:
          places: of some nodes.
        """
        lines = list(lines)
        for node, ends in self._ends.items():
            lane, at_start = ends[0]
            own = lines[lane][0 if at_start else -1]
            place = places.get(node, own)
            place = own if np.hypot(*(place - own)[:2]) > SAME_PLACE else place
            for lane, at_start in ends:
                lines[lane] = line_to(lines[lane], place, at_start)
        return lines

    def moved(
        self, lane: int, fields: Sequence[Mapping[int, _Shift]], factors: Float64[np.ndarray, "joints 2 3"]
    ) -> Float64[np.ndarray, "n 3"]:
        """A line with the shifts of all joints, and more points where it bends."""
        line, length = self._lines[lane], self._lengths[lane]
        ends = [(field.get(self.node(lane, True)), field.get(self.node(lane, False))) for field in fields]
        if not any(start or end for start, end in ends):
            return line
        arc = cumulative_length(line)
        reach = max(one.left for pair in ends for one in pair if one)
        knots = np.arange(0.0, length, _STEP)
        from_start, from_end = (any(pair[k] for pair in ends) for k in (0, 1))
        bends = (from_start & (knots < reach)) | (from_end & (knots > length - reach))
        places = np.unique(np.concatenate([arc, knots[bends]]))
        places = places[np.diff(places, prepend=-1.0) > _LEAST_STEP]
        places = np.append(places[places < length - _LEAST_STEP], length) if length > _LEAST_STEP else arc
        points = np.stack([np.interp(places, arc, column) for column in line.T], -1)
        return points + self.shifts(lane, places, fields, factors)

    def shifts(
        self,
        lane: int,
        places: Float64[np.ndarray, " n"],
        fields: Sequence[Mapping[int, _Shift]],
        factors: Float64[np.ndarray, "joints 2 3"],
    ) -> Float64[np.ndarray, "n 3"]:
        """How far all joints together move a line at places along it [m]."""
        length, shifts = self._lengths[lane], np.zeros((len(places), 3))
        for field, factor in zip(fields, factors, strict=True):
            start, end = field.get(self.node(lane, True)), field.get(self.node(lane, False))
            if start and end:
                shifts += _between(places, length, start[:2], end[:2])[0] @ factor
            elif start:
                shifts += _faded(places, start, 1.0)[0] @ factor
            elif end:
                shifts += _faded(length - places, end, -1.0)[0] @ factor
        return shifts


def _faded(
    places: Float64[np.ndarray, " n"], here: _Shift, sign: float
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2"]]:
    """Factors and their slopes at distances from a place, along the road (1) or against it (-1)."""
    return _between(places, here.left, (here.shift, sign * here.slope), (np.zeros(2), np.zeros(2)))
