"""Polylines -> smooth curves of cubic pieces with given directions at both ends, which can be cut and joined.

Pieces are Bezier curves. The fit is that of Schneider (Graphics Gems, 1990): least squares for the lengths of the two
tangents, and a split at the worst point while it is farther off than the tolerance.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from scjax.export.roads.lane_network import line_headings
from scjax.scene.polyline import cumulative_length, thinned

TOLERANCE = 0.05
"""Distance between a curve and the points that it is fitted to [m]."""

_HEIGHT_TOLERANCE = 0.02  # m
_MIN_REACH, _MAX_REACH = 0.15, 0.8  # of the tangents of a piece, as shares of its chord; a half circle has 2/3
_MIN_STEP = 0.1  # m between two points that are fitted
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_SAMPLES = 33  # of a piece, for its arc length at a parameter
_TURNED_LENGTH = 4.0  # m at the end of a curve that gets another direction
_LEAST_BEYOND = 1e-3  # m that a curve is made longer
_SHORT_LENGTH, _SHORT_TURN = 2.0, float(np.deg2rad(15.0))  # a shorter curve with a greater turn becomes straight
_LEAST_PIECE = 0.5  # m; netconvert takes a bend within a shorter one for a sharp turn


@dataclasses.dataclass(frozen=True)
class LaneCurve:
    """A smooth curve in the plane, and heights along it.

    Attributes:
      pieces: control points of cubic Bezier curves in a row [m].
      heights: arc length and z of points between which z is linear [m].
    """

    pieces: Float64[np.ndarray, "pieces 4 2"]
    heights: Float64[np.ndarray, "heights 2"]

    @functools.cached_property
    def lengths(self) -> Float64[np.ndarray, " pieces"]:
        """Arc length of every piece [m]."""
        return np.array([piece_length(piece) for piece in self.pieces])

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self.lengths.sum())


def fit_curve(line: Float64[np.ndarray, "n 3"], start: float, end: float) -> LaneCurve:
    """The curve through a polyline that begins and ends in the directions ``start`` and ``end`` [rad]."""
    line = thinned(line, _MIN_STEP)
    headings = line_headings(line)
    headings[0], headings[-1] = start, end
    arc = cumulative_length(line)
    pieces, places = _fit(line[:, :2], headings, arc)
    curve = LaneCurve(pieces, np.zeros((2, 2)))
    ends = np.concatenate([[0.0], np.cumsum(curve.lengths)])
    at = np.interp(arc, arc[places], ends)
    return dataclasses.replace(curve, heights=_simplified(np.stack([at, line[:, 2]], -1)))


def _fit(points: np.ndarray, headings: np.ndarray, arc: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Pieces, and the rows of points where they begin and end."""
    pieces, places, open_spans = [], [0], [(0, len(points) - 1)]
    while open_spans:
        first, last = open_spans.pop()
        piece, worst = _fit_piece(points[first : last + 1], headings[first], headings[last], arc[first : last + 1])
        if worst is None:
            pieces.append(piece)
            places.append(last)
        else:
            open_spans += [(first + worst, last), (first, first + worst)]
    return np.array(pieces), places


def _fit_piece(points: np.ndarray, start: float, end: float, arc: np.ndarray) -> tuple[np.ndarray, int | None]:
    """A piece, and the row of the point that is too far off, if one is."""
    chord = float(np.hypot(*(points[-1] - points[0])))
    out, back = (np.array([np.cos(angle), np.sin(angle)]) for angle in (start, end + np.pi))
    u = (arc - arc[0]) / (arc[-1] - arc[0])
    third = max(chord, 1e-9) / 3
    piece = _piece(points, out * third, back * third)
    if len(points) == 2:
        return piece, None
    for _ in range(4):
        reach = _tangent_lengths(points, out, back, u)
        if not ((reach > _MIN_REACH * chord) & (reach < _MAX_REACH * chord)).all():
            reach = np.array([third, third])
        piece = _piece(points, out * reach[0], back * reach[1])
        error = np.hypot(*(piece_points(piece, u) - points).T)
        if error.max() <= TOLERANCE:
            return piece, None
        u = _nearest_parameters(piece, points, u)
    return piece, int(np.clip(error.argmax(), 1, len(points) - 2))


def _piece(points: np.ndarray, out: np.ndarray, back: np.ndarray) -> np.ndarray:
    return np.stack([points[0], points[0] + out, points[-1] + back, points[-1]])


def _tangent_lengths(points: np.ndarray, out: np.ndarray, back: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Lengths of both tangents that make the piece pass nearest to the points at parameters ``u`` [m]."""
    weights = _bernstein(u)
    fixed = weights[:, :2].sum(1)[:, None] * points[0] + weights[:, 2:].sum(1)[:, None] * points[-1]
    columns = np.stack([weights[:, 1:2] * out, weights[:, 2:3] * back], -1).reshape(-1, 2)
    return np.linalg.lstsq(columns, (points - fixed).reshape(-1), rcond=None)[0]


def _nearest_parameters(piece: np.ndarray, points: np.ndarray, u: np.ndarray) -> np.ndarray:
    """One Newton step of the parameters towards the nearest places on the piece; the ends stay."""
    offset = piece_points(piece, u) - points
    first, second = piece_tangents(piece, u), _second_derivatives(piece, u)
    slope = (first * first).sum(1) + (offset * second).sum(1)
    step = np.where(np.abs(slope) > 1e-12, (offset * first).sum(1) / np.where(np.abs(slope) > 1e-12, slope, 1.0), 0.0)
    moved = np.clip(u - step, 0.0, 1.0)
    moved[0], moved[-1] = 0.0, 1.0
    return np.maximum.accumulate(moved)


def _bernstein(u: np.ndarray) -> np.ndarray:
    v = 1 - u
    return np.stack([v**3, 3 * u * v**2, 3 * u**2 * v, u**3], -1)


def piece_points(piece: Float64[np.ndarray, "4 2"], u: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
    """Places on a piece at parameters from 0 to 1 [m]."""
    return _bernstein(u) @ piece


def piece_tangents(piece: Float64[np.ndarray, "4 2"], u: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
    """Derivatives by the parameter."""
    v, steps = 1 - u, np.diff(piece, axis=0)
    return 3 * np.stack([v**2, 2 * u * v, u**2], -1) @ steps


def _second_derivatives(piece: np.ndarray, u: np.ndarray) -> np.ndarray:
    return 6 * np.stack([1 - u, u], -1) @ np.diff(piece, 2, axis=0)


def piece_length(piece: Float64[np.ndarray, "4 2"]) -> float:
    """Arc length of a piece [m]."""
    edges = np.linspace(0, 1, 5)
    u = (edges[:-1, None] + np.diff(edges)[:, None] * (1 + _NODES) / 2).reshape(-1)
    speed = np.hypot(*piece_tangents(piece, u).T).reshape(4, -1)
    return float((speed * _WEIGHTS).sum() / 8)


def _simplified(table: np.ndarray) -> np.ndarray:
    """Rows of (place, value) between which straight lines keep within ``_HEIGHT_TOLERANCE`` (Douglas-Peucker)."""
    keep, open_spans = {0, len(table) - 1}, [(0, len(table) - 1)]
    while open_spans:
        first, last = open_spans.pop()
        part = table[first : last + 1]
        error = np.abs(np.interp(part[:, 0], part[[0, -1], 0], part[[0, -1], 1]) - part[:, 1])
        if error.max() > _HEIGHT_TOLERANCE:
            worst = first + int(error.argmax())
            keep.add(worst)
            open_spans += [(first, worst), (worst, last)]
    return table[sorted(keep)]


def cut_curve(curve: LaneCurve, start: float, end: float) -> LaneCurve:
    """The part of a curve between two arc lengths [m]."""
    bounds = np.concatenate([[0.0], np.cumsum(curve.lengths)])
    start, end = max(start, 0.0), min(end, float(bounds[-1]))
    pieces = []
    for piece, low, high in zip(curve.pieces, bounds[:-1], bounds[1:], strict=True):
        inner = max(start, low), min(end, high)
        if inner[1] - inner[0] > 1e-6 or (inner[1] > inner[0] and not pieces):
            pieces.append(_cut_piece(piece, *_parameters(piece, np.array(inner) - low)))
    inside = (curve.heights[:, 0] > start + 1e-6) & (curve.heights[:, 0] < end - 1e-6)
    places = np.concatenate([[start], curve.heights[inside, 0], [end]])
    heights = np.interp(places, *curve.heights.T)
    return LaneCurve(np.array(pieces), np.stack([places - start, heights], -1))


def _parameters(piece: np.ndarray, arcs: np.ndarray) -> np.ndarray:
    """Parameters at arc lengths on a piece [m]."""
    u = np.linspace(0, 1, _SAMPLES)
    middle = (u[:-1, None] + np.diff(u)[:, None] * (1 + _NODES[None]) / 2).reshape(-1)
    speed = np.hypot(*piece_tangents(piece, middle).T).reshape(_SAMPLES - 1, -1)
    arc = np.concatenate([[0.0], np.cumsum((speed * _WEIGHTS).sum(1) / 2 / (_SAMPLES - 1))])
    at = np.interp(arcs, arc, u)
    for _ in range(3):
        row = np.clip(np.searchsorted(u, at, side="right") - 1, 0, _SAMPLES - 2)
        half = (at - u[row]) / 2
        nodes = (u[row] + half)[:, None] + half[:, None] * _NODES
        partial = np.hypot(*piece_tangents(piece, nodes.reshape(-1)).T).reshape(nodes.shape)
        here = arc[row] + half * (partial * _WEIGHTS).sum(1)
        at = np.clip(at - (here - arcs) / np.maximum(np.hypot(*piece_tangents(piece, at).T), 1e-9), 0.0, 1.0)
    return at


def _cut_piece(piece: np.ndarray, start: float, end: float) -> np.ndarray:
    """The part of a piece between two parameters."""
    points, tangents = piece_points(piece, np.array([start, end])), piece_tangents(piece, np.array([start, end]))
    third = (end - start) / 3
    return np.stack([points[0], points[0] + third * tangents[0], points[1] - third * tangents[1], points[1]])


def join_curves(curves: Sequence[LaneCurve]) -> LaneCurve:
    """Curves that follow each other, as one."""
    starts = np.cumsum([0.0, *(curve.length for curve in curves[:-1])])
    heights = [
        np.column_stack([curve.heights[:, 0] + start, curve.heights[:, 1]])[0 if start == 0 else 1 :]
        for curve, start in zip(curves, starts, strict=True)
    ]
    return LaneCurve(np.concatenate([curve.pieces for curve in curves]), np.concatenate(heights))


def curve_line(curve: LaneCurve, spacing: float = 1.0) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]]:
    """Points of a curve at about this spacing [m], and their arc lengths [m]."""
    places, arcs, start = [], [], 0.0
    for row, (piece, length) in enumerate(zip(curve.pieces, curve.lengths, strict=True)):
        count = max(int(np.ceil(length / spacing)), 2)
        arc = np.linspace(0, length, count + 1)[0 if row == 0 else 1 :]
        places.append(piece_points(piece, _parameters(piece, arc)))
        arcs.append(start + arc)
        start += length
    arc = np.concatenate(arcs)
    return np.column_stack([np.concatenate(places), np.interp(arc, *curve.heights.T)]), arc


def without_short_bend(curve: LaneCurve, from_end: bool) -> LaneCurve:
    """A straight curve of the same length in the place of a short one that bends; others as they are.

    Args:
      from_end: whether it keeps its end and the direction there; else those of its start.
    """
    (first, last), headings = curve_frames(curve, np.array([0.0, curve.length]))
    if curve.length > _SHORT_LENGTH or abs(np.angle(np.exp(1j * (headings[1] - headings[0])))) < _SHORT_TURN:
        return curve
    heading = headings[int(from_end)]
    step = curve.length * np.array([np.cos(heading), np.sin(heading)])
    start = last - step if from_end else first
    return dataclasses.replace(curve, pieces=(start + np.linspace(0.0, 1.0, 4)[:, None] * step)[None])


def curve_frames(
    curve: LaneCurve, arcs: Float64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Places [m] and directions [rad] at arc lengths; beyond both ends a curve goes straight on."""
    bounds = np.concatenate([[0.0], np.cumsum(curve.lengths)])
    inner = np.clip(arcs, 0.0, bounds[-1])
    row = np.clip(np.searchsorted(bounds, inner, side="right") - 1, 0, len(curve.pieces) - 1)
    points, ways = np.empty((len(arcs), 2)), np.empty((len(arcs), 2))
    for k in np.unique(row).tolist():
        u = _parameters(curve.pieces[k], inner[row == k] - bounds[k])
        points[row == k], ways[row == k] = piece_points(curve.pieces[k], u), piece_tangents(curve.pieces[k], u)
    ways /= np.maximum(np.hypot(*ways.T), 1e-12)[:, None]
    return points + (arcs - inner)[:, None] * ways, np.arctan2(ways[:, 1], ways[:, 0])


def reversed_curve(curve: LaneCurve) -> LaneCurve:
    """The curve in the other direction."""
    heights = np.column_stack([curve.heights[-1, 0] - curve.heights[::-1, 0], curve.heights[::-1, 1]])
    return LaneCurve(curve.pieces[::-1, ::-1], heights)


def part_of_curve(curve: LaneCurve, start: float, end: float) -> LaneCurve:
    """The part between two arc lengths [m]; it goes straight on, and level, where they lie beyond the curve."""
    length = curve.length
    parts = [cut_curve(curve, start, end)]
    if start < -_LEAST_BEYOND:
        parts.insert(0, _straight_curve(curve, start, 0.0, float(curve.heights[0, 1])))
    if end > length + _LEAST_BEYOND:
        parts.append(_straight_curve(curve, length, end, float(curve.heights[-1, 1])))
    return join_curves(parts) if len(parts) > 1 else parts[0]


def _straight_curve(curve: LaneCurve, start: float, end: float, z: float) -> LaneCurve:
    """A level part beyond an end of a curve."""
    ends = curve_frames(curve, np.array([start, end]))[0]
    piece = ends[0] + np.linspace(0.0, 1.0, 4)[:, None] * (ends[1] - ends[0])
    return LaneCurve(piece[None], np.array([[0.0, z], [end - start, z]]))


def with_end_heights(curve: LaneCurve, start: float, end: float) -> LaneCurve:
    """The curve with these heights at its ends [m]; what they differ from its own goes away evenly along it."""
    table = curve.heights.copy()
    share = table[:, 0] / max(table[-1, 0], 1e-9)
    table[:, 1] += (1 - share) * (start - table[0, 1]) + share * (end - table[-1, 1])
    return dataclasses.replace(curve, heights=table)


def with_end_headings(curve: LaneCurve, start: float | None, end: float | None) -> LaneCurve:
    """The curve with these directions at its ends [rad], where one is given; only the parts near the ends change."""
    if start is not None:
        curve = _turned(curve, start)
    return curve if end is None else reversed_curve(_turned(reversed_curve(curve), end + np.pi))


def without_short_ends(curve: LaneCurve) -> LaneCurve:
    """The curve with pieces of nearly no length at its ends joined to the next one."""
    for turn in (lambda same: same, reversed_curve):
        curve = turn(curve)
        if len(curve.pieces) > 1 and curve.lengths[0] < _LEAST_PIECE:
            size = float(curve.lengths[:2].sum())
            (heading,) = curve_frames(curve, np.zeros(1))[1].tolist()
            curve = _with_first_piece(curve, heading, size)
        curve = turn(curve)
    return curve


def _turned(curve: LaneCurve, heading: float) -> LaneCurve:
    """The curve with another direction at its start: one piece leads to where it goes on as before."""
    return _with_first_piece(curve, heading, min(_TURNED_LENGTH, curve.length / 2))


def _with_first_piece(curve: LaneCurve, heading: float, size: float) -> LaneCurve:
    """The curve with one piece in place of its first ``size`` meters, which begins in direction ``heading`` [rad]."""
    length = curve.length
    places, headings = curve_frames(curve, np.array([0.0, size]))
    headings[0] = heading
    third = size / 3 * np.stack([np.cos(headings), np.sin(headings)], -1)
    piece = np.stack([places[0], places[0] + third[0], places[1] - third[1], places[1]])
    rest = cut_curve(curve, size, length).pieces if length - size > _LEAST_BEYOND else np.empty((0, 4, 2))
    pieces = np.concatenate([piece[None], rest])
    heights = curve.heights * np.array([float(sum(map(piece_length, pieces))) / length, 1.0])
    return LaneCurve(pieces, heights)
