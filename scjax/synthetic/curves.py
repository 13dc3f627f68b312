"""Curves in the plane: clothoids and arcs by curvature, cubic curves between poses, and operations on polylines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from scjax.scene.polyline import cumulative_length

ROAD_SPACING = 2.0  # m between the points of a road
TURN_SPACING = 1.0  # m between the points of a turn

Line = Float64[np.ndarray, "_ 2"]
"""Points of a polyline [m]."""

_CUBIC_REACH = 0.39  # of the distance between the ends, to each control point; close to an arc for a turn of 90 degrees
_MIN_CORNER_ANGLE_SINE = 0.35
_MIN_CORNER_REACH = 2.0  # m
STRAIGHT_END = 1.1  # m of a turn before its arc, and after it
_MIN_POINT_SPACING = 0.25  # m between a cut and the next point of a line


def clothoid(lengths: Sequence[float | int], curvatures: Sequence[float | int], spacing: float = ROAD_SPACING) -> Line:
    """A line from the origin along +x whose curvature is piecewise linear; equal curvatures give an arc.

    Args:
      lengths: of the n pieces [m].
      curvatures: at the n + 1 ends of the pieces [1/m], positive to the left.
      spacing: distance between points [m].
    """
    knots = np.concatenate([[0.0], np.cumsum(np.asarray(lengths, float))])
    arc = np.linspace(0, knots[-1], max(2, round(knots[-1] / spacing) + 1))
    curvature = np.interp(arc, knots, np.asarray(curvatures, float))
    step = arc[1] - arc[0]
    heading = np.concatenate([[0.0], np.cumsum((curvature[1:] + curvature[:-1]) / 2 * step)])
    middle_heading = (heading[1:] + heading[:-1]) / 2
    steps = step * np.stack([np.cos(middle_heading), np.sin(middle_heading)], -1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)])


def arcs(turns: Sequence[float], radius: float, spacing: float) -> Line:
    """Arcs of ``radius`` [m], one after the other, from the origin along +x; ``turns`` in rad, positive to the left."""
    points = [np.zeros((1, 2))]
    heading = 0.0
    for turn in turns:
        angle = np.linspace(0, turn, max(3, round(abs(turn) * radius / spacing) + 1))[1:, None]
        left = np.sign(turn) * np.array([-np.sin(heading), np.cos(heading)])
        ahead = np.array([np.cos(heading), np.sin(heading)])
        points.append(points[-1][-1] + radius * (np.sin(np.abs(angle)) * ahead + (1 - np.cos(angle)) * left))
        heading += turn
    return np.concatenate(points)


def cubic_curve(
    start: np.ndarray, start_heading: float, end: np.ndarray, end_heading: float, spacing: float = ROAD_SPACING
) -> Line:
    """A cubic Bezier curve between two positions [m] and headings [rad]."""
    reach = _CUBIC_REACH * float(np.hypot(*(end - start)))
    a = start + reach * np.array([np.cos(start_heading), np.sin(start_heading)])
    b = end - reach * np.array([np.cos(end_heading), np.sin(end_heading)])
    t = np.linspace(0, 1, 60)[:, None]
    points = (1 - t) ** 3 * start + 3 * (1 - t) ** 2 * t * a + 3 * (1 - t) * t**2 * b + t**3 * end
    return resample_line(points, spacing)


def turn_curve(before: Line, after: Line) -> Line:
    """A line from the end of one lane to the start of another: straight, an arc tangent to both lanes, straight."""
    start, end = before[-1], after[0]
    start_direction, end_direction = _unit(before[-1] - before[-2]), _unit(after[1] - after[0])
    cross = start_direction[0] * end_direction[1] - start_direction[1] * end_direction[0]
    if abs(cross) > _MIN_CORNER_ANGLE_SINE:
        gap = end - start
        # Distances from both ends to the corner, where the two directions meet.
        to_corner = (gap[0] * end_direction[1] - gap[1] * end_direction[0]) / cross
        from_corner = (start_direction[0] * gap[1] - start_direction[1] * gap[0]) / cross
        reach = min(to_corner, from_corner) - STRAIGHT_END
        if reach > _MIN_CORNER_REACH:
            corner = start + to_corner * start_direction
            bend = _fillet(corner, start_direction, end_direction, reach)
            return resample_line(np.concatenate([start[None], bend, end[None]]), TURN_SPACING)
    return cubic_curve(start, _heading(start_direction), end, _heading(end_direction), TURN_SPACING)


def _fillet(corner: np.ndarray, start_direction: np.ndarray, end_direction: np.ndarray, reach: float) -> Line:
    """The arc that is tangent to two directions at ``reach`` [m] before and after ``corner``, without its ends."""
    cross = start_direction[0] * end_direction[1] - start_direction[1] * end_direction[0]
    turn = float(np.arctan2(cross, start_direction @ end_direction))
    radius = reach / np.tan(turn / 2)  # negative to the right
    angle = np.linspace(0, turn, max(8, round(abs(radius * turn) / 0.5)))[1:-1, None]
    left = np.array([-start_direction[1], start_direction[0]])
    start = corner - reach * start_direction
    return start + radius * (np.sin(angle) * start_direction + (1 - np.cos(angle)) * left)


def straight_line(start: np.ndarray, heading: float, length: float) -> Line:
    """A straight line from ``start`` [m], with points about ``ROAD_SPACING`` apart."""
    arc = np.linspace(0, length, max(2, round(length / ROAD_SPACING) + 1))[:, None]
    return start + arc * np.array([np.cos(heading), np.sin(heading)])


def transform_line(line: Line, translation: np.ndarray, rotation: float) -> Line:
    """``line`` rotated about the origin [rad], then translated [m]."""
    cos, sin = np.cos(rotation), np.sin(rotation)
    return line @ np.array([[cos, sin], [-sin, cos]]) + translation


def offset_line(line: Line, left: float | np.ndarray) -> Line:
    """``line`` shifted to its left [m], by one value or by one per point [points]."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return line + np.stack([-tangent[:, 1], tangent[:, 0]], -1) * np.reshape(left, (-1, 1))


def resample_line(line: Line, spacing: float) -> Line:
    """``line`` with at least four points, at equal distances of about ``spacing`` [m]."""
    arc = cumulative_length(line)
    positions = np.linspace(0, arc[-1], max(4, round(arc[-1] / spacing) + 1))
    return np.stack([np.interp(positions, arc, line[:, d]) for d in (0, 1)], -1)


def slice_line(line: Line, start: float, end: float) -> Line:
    """The part of ``line`` between two arc lengths [m]."""
    arc = cumulative_length(line)
    inner = arc[(arc > start + _MIN_POINT_SPACING) & (arc < end - _MIN_POINT_SPACING)]
    positions = np.concatenate([[start], inner, [end]])
    return np.stack([np.interp(positions, arc, line[:, d]) for d in (0, 1)], -1)


def line_length(line: Line) -> float:
    """Length of ``line`` [m]."""
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.hypot(*vector)


def _heading(vector: np.ndarray) -> float:
    return float(np.arctan2(vector[1], vector[0]))
