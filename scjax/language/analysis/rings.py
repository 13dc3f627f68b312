"""Roundabouts: lanes that run once round an empty middle."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64

from scjax.language.analysis.lane_lines import LaneLines
from scjax.scene.angles import wrap_to_pi

_MIN_RADIUS, _MAX_RADIUS = 5.0, 34.0  # m
_MIN_ARC_TURN = np.deg2rad(15.0)  # of a lane that may be part of a ring
_MAX_MISFIT = 0.8  # m, of a lane from its circle
_TANGENT_COSINE = 0.92  # of the angle between a lane and the circle
_BAND = 1.8  # m, on both sides of the circle
_MIN_CURVATURE = 0.35  # of the circle's, of lanes along it
_SECTORS = 48
_MIN_SHARE = 0.72  # of the visible circle that lanes run along
_MIN_VISIBLE = 0.4  # of the circle inside the window
_ROAD_REACH, _ROAD_ANGLE = 6.0, np.deg2rad(35.0)  # m around a ring, rad between the roads that lead to it
_EMPTY_SHARE = 0.6  # of the radius, inside of which no lane runs


@dataclasses.dataclass(frozen=True)
class Ring:
    """A roundabout's ring.

    Attributes:
      center: [m].
      radius: of the outermost lane that was matched [m].
    """

    center: Float64[np.ndarray, 2]
    radius: float


def find_ring(lines: LaneLines, window: tuple[float, float, float, float]) -> Ring | None:
    """The ring that lanes run along most completely; None without one."""
    centers, radii, senses = _circles(lines)
    best: tuple[float, Ring] | None = None
    for center, radius, sense in zip(centers, radii, senses, strict=True):
        share = _covered_share(lines, center, radius, sense, window)
        if share >= _MIN_SHARE and (best is None or share > best[0]):
            best = share, Ring(center, float(radius))
    return None if best is None else best[1]


def count_ring_roads(lines: LaneLines, ring: Ring) -> int:
    """Number of roads that lead to a ring; a turning circle at a dead end has one.

    Lanes that come from outside to within 6 m of the ring are one road if less than 35 degrees lie between them, seen
    from its middle.
    """
    offset = lines.points[..., :2] - ring.center
    distance = np.where(lines.real, np.hypot(offset[..., 0], offset[..., 1]), np.inf)
    outside = np.where(lines.real, distance, 0.0).max(1) > ring.radius + _ROAD_REACH + _BAND
    leads = outside & (distance.min(1) < ring.radius + _ROAD_REACH)
    nearest = offset[np.arange(len(lines)), distance.argmin(1)][leads]
    bearing = np.sort(np.arctan2(nearest[:, 1], nearest[:, 0]))
    if not len(bearing):
        return 0
    gaps = np.diff([*bearing, bearing[0] + 2 * np.pi])
    return max(1, int((gaps > _ROAD_ANGLE).sum()))


def _circles(lines: LaneLines) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers, radii and senses (1 counter-clockwise) of circles that fit bent lanes, without repetitions."""
    rows = np.flatnonzero((np.abs(lines.turn) > _MIN_ARC_TURN) & (lines.length > 4.0))
    points = lines.raw[rows][..., :2]
    middle = points.mean(1, keepdims=True)
    x, y = np.moveaxis(points - middle, -1, 0)
    design = np.stack([x, y, np.ones_like(x)], -1)
    normal = np.einsum("lpi,lpj->lij", design, design) + 1e-9 * np.eye(3)
    solution = np.linalg.solve(normal, np.einsum("lpi,lp->li", design, x * x + y * y)[..., None])[..., 0]
    center = solution[:, :2] / 2
    radius = np.sqrt(np.maximum(solution[:, 2] + (center**2).sum(-1), 0.0))
    misfit = np.abs(np.hypot(x - center[:, :1], y - center[:, 1:]) - radius[:, None]).max(1)
    fits = (misfit < _MAX_MISFIT) & (radius > _MIN_RADIUS) & (radius < _MAX_RADIUS)
    circles = np.column_stack([(center + middle[:, 0])[fits], radius[fits], np.sign(lines.turn[rows][fits])])
    _, unique = np.unique((circles / 2.0).round(), axis=0, return_index=True)
    circles = circles[unique]
    return circles[:, :2], circles[:, 2], circles[:, 3]


def _covered_share(lines: LaneLines, center: np.ndarray, radius: float, sense: float, window) -> float:
    """Share of the visible circle along which lanes run in one sense; 0 if its middle holds a lane."""
    offset = lines.points[..., :2] - center
    distance = np.hypot(offset[..., 0], offset[..., 1])
    if (lines.real & (distance < _EMPTY_SHARE * radius)).any():
        return 0.0
    sectors = np.linspace(-np.pi, np.pi, _SECTORS, endpoint=False) + np.pi / _SECTORS
    circle = center + radius * np.stack([np.cos(sectors), np.sin(sectors)], -1)
    x0, x1, y0, y1 = window
    visible = (circle[:, 0] > x0) & (circle[:, 0] < x1) & (circle[:, 1] > y0) & (circle[:, 1] < y1)
    if visible.mean() < _MIN_VISIBLE:
        return 0.0
    bearing = np.arctan2(offset[..., 1], offset[..., 0])
    tangent = np.cos(wrap_to_pi(lines.headings - bearing - sense * np.pi / 2))
    bend = np.zeros_like(distance)
    bend[:, 1:-1] = sense * wrap_to_pi(lines.headings[:, 2:] - lines.headings[:, :-2]) / (2 * lines.spacing[:, None])
    bend[:, [0, -1]] = bend[:, [1, -2]] if bend.shape[1] > 2 else 0.0
    bend[np.arange(len(lines)), lines.count - 1] = 1.0  # unknown at the end
    on_circle = (
        lines.real
        & (bend > _MIN_CURVATURE / radius)
        & (np.abs(distance - radius) < _BAND)
        & (tangent > _TANGENT_COSINE)
    )
    covered = np.zeros(_SECTORS, bool)
    covered[((bearing[on_circle] + np.pi) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS] = True
    return float((covered & visible).sum() / visible.sum())
