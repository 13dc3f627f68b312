"""Plane curves that roads are made of: clothoids and arcs by their curvature, splines between given directions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

SPACING = 2.0  # metres between the points of a road
FINE = 1.0  # metres between the points of a turn

Line = Float64[np.ndarray, "_ 2"]


def by_curvature(lengths: Sequence[float | int], curvatures: Sequence[float | int], spacing: float = SPACING) -> Line:
    """From the origin along +x: curvature [1/m] changes linearly over each of ``lengths`` (clothoids; equal: arcs).

    Args:
      lengths: of the n pieces [m]; curvatures: at their n + 1 ends.
    """
    knots = np.concatenate([[0.0], np.cumsum(np.asarray(lengths, float))])
    arc = np.linspace(0, knots[-1], max(2, round(knots[-1] / spacing) + 1))
    curvature = np.interp(arc, knots, np.asarray(curvatures, float))
    step = arc[1] - arc[0]
    heading = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * step)])
    middle = (heading[1:] + heading[:-1]) / 2
    moves = step * np.stack([np.cos(middle), np.sin(middle)], -1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(moves, 0)])


def spline(start: np.ndarray, out: float, end: np.ndarray, into: float, spacing: float = SPACING) -> Line:
    """Cubic curve from ``start`` in direction ``out`` to ``end`` in direction ``into`` [rad]."""
    reach = 0.39 * float(np.hypot(*(end - start)))
    a = start + reach * np.array([np.cos(out), np.sin(out)])
    b = end - reach * np.array([np.cos(into), np.sin(into)])
    t = np.linspace(0, 1, 60)[:, None]
    curve = (1 - t) ** 3 * start + 3 * (1 - t) ** 2 * t * a + 3 * (1 - t) * t**2 * b + t**3 * end
    return resample_line(curve, spacing)


def turn(before: Line, after: Line) -> Line:
    """From the end of one lane to the start of another, along both their directions: straight, then nearly an arc."""
    start, end = before[-1], after[0]
    out, into = _unit(before[-1] - before[-2]), _unit(after[1] - after[0])
    across = out[0] * into[1] - out[1] * into[0]
    if abs(across) > 0.35:
        gap = end - start
        # Distances from both ends to the corner where the two directions meet.
        to_corner = (gap[0] * into[1] - gap[1] * into[0]) / across
        from_corner = (out[0] * gap[1] - out[1] * gap[0]) / across
        reach = min(to_corner, from_corner)
        if reach > 2.0:
            corner = start + to_corner * out
            bend = spline(corner - reach * out, _angle(out), corner + reach * into, _angle(into), 0.5)
            return resample_line(np.concatenate([start[None], bend[1:-1], end[None]]), FINE)
    return spline(start, _angle(out), end, _angle(into), FINE)


def straight(start: np.ndarray, direction: float, length: float) -> Line:
    """Points ``SPACING`` apart or a little less."""
    at = np.linspace(0, length, max(2, round(length / SPACING) + 1))[:, None]
    return start + at * np.array([np.cos(direction), np.sin(direction)])


def moved(line: Line, start: np.ndarray, direction: float) -> Line:
    """``line`` turned by ``direction`` [rad] about the origin, then carried to ``start``."""
    cos, sin = np.cos(direction), np.sin(direction)
    return line @ np.array([[cos, sin], [-sin, cos]]) + start


def offset(line: Line, left: float | np.ndarray) -> Line:
    """``line`` moved to its left by so many metres, the same everywhere or [points]."""
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return line + np.stack([-along[:, 1], along[:, 0]], -1) * np.reshape(left, (-1, 1))


def resample_line(line: Line, spacing: float) -> Line:
    """``line`` with points at equal distances of about ``spacing`` metres, four at least."""
    arc = arc_of(line)
    at = np.linspace(0, arc[-1], max(4, round(arc[-1] / spacing) + 1))
    return np.stack([np.interp(at, arc, line[:, d]) for d in (0, 1)], -1)


def part(line: Line, start: float, end: float) -> Line:
    """The stretch of ``line`` between two arc lengths [m]."""
    arc = arc_of(line)
    inner = arc[(arc > start + 0.25) & (arc < end - 0.25)]
    at = np.concatenate([[start], inner, [end]])
    return np.stack([np.interp(at, arc, line[:, d]) for d in (0, 1)], -1)


def arc_of(line: Line) -> Float64[np.ndarray, " points"]:
    """Arc length from the start to each point [m]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])


def length_of(line: Line) -> float:
    """Arc length [m]."""
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def smooth(t: np.ndarray) -> np.ndarray:
    """0 to 1 as ``t`` goes from 0 to 1, level at both ends."""
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.hypot(*vector)


def _angle(vector: np.ndarray) -> float:
    return float(np.arctan2(vector[1], vector[0]))
