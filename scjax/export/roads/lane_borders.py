"""Borders of the lanes of a road, as offsets from its reference line."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.export.roads.lane_curves import LaneCurve, curve_frames
from scjax.export.traffic import LANE_WIDTH

_CHORD, _STEPS = 2.0, 4  # m between points that netconvert puts on a curve, at most; steps between two of them
_TOLERANCE = 0.01  # m between a border and the cubic pieces that it is written as
_SOLVED = 1e-4  # m
_PARALLEL_LENGTH = 4.0  # m at both ends of a road in which lanes turn to run along its reference line
_LEAST_WIDTH, _MOST_WIDTH = 2.4, 5.0  # m


class LaneBorders(NamedTuple):
    """Borders at stations of the reference line; between two stations they are cubic.

    Attributes:
      stations: arc lengths on the reference line [m].
      offsets: of the borders from left to right; positive on the left of the line [m].
      slopes: how they change along the line.
    """

    stations: Float64[np.ndarray, " n"]
    offsets: Float64[np.ndarray, "n borders"]
    slopes: Float64[np.ndarray, "n borders"]


def lane_arcs(
    reference: LaneCurve, curve: LaneCurve, stations: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"] | None:
    """Where a curve crosses the lines across the reference line at these stations [m]; None if it does not."""
    places, headings = curve_frames(reference, stations)
    along = np.stack([np.cos(headings), np.sin(headings)], -1)
    arcs = _first_guess(curve, places)
    for _ in range(12):
        points, ways = curve_frames(curve, arcs)
        cosine = np.cos(ways - headings)
        if (cosine < 0.5).any():
            return None
        missed = ((points - places) * along).sum(1)
        if np.abs(missed).max() < _SOLVED / 100:
            return arcs
        arcs = arcs - missed / cosine
    return arcs if np.abs(missed).max() < _SOLVED else None


def _first_guess(curve: LaneCurve, places: np.ndarray) -> np.ndarray:
    """Arc lengths of a curve's points nearest to these places."""
    arcs = np.linspace(0.0, curve.length, max(int(curve.length), 2))
    points = curve_frames(curve, arcs)[0]
    return arcs[np.hypot(*(points[None] - places[:, None]).transpose(2, 0, 1)).argmin(1)]


def single_lane_borders(curve: LaneCurve, widths: tuple[float, float]) -> LaneBorders:
    """The borders of a lane in the middle of which the reference line runs, with these widths at its ends [m]."""
    half, length = np.array(widths) / 2, curve.length
    slope = (half[1] - half[0]) / length
    return LaneBorders(np.array([0.0, length]), np.stack([half, -half], -1), np.tile(np.array([slope, -slope]), (2, 1)))


def joined_lane_borders(reference: LaneCurve, lanes: Sequence[LaneCurve]) -> LaneBorders | None:
    """The borders at small steps of lanes from left to right, whose middles lie halfway between two of them.

    None if a lane does not run beside the reference line.
    """
    stations = _stations(reference)
    places, headings = curve_frames(reference, stations)
    bend = np.gradient(np.unwrap(headings), stations)
    aside = np.stack([-np.sin(headings), np.cos(headings)], -1)
    middles, slopes = [], []
    for lane in lanes:
        arcs = lane_arcs(reference, lane, stations)
        if arcs is None:
            return None
        points, ways = curve_frames(lane, arcs)
        middle = ((points - places) * aside).sum(1)
        middle, slope = _parallel_at_ends(stations, middle, np.tan(ways - headings) * (1 - bend * middle))
        middles.append(middle)
        slopes.append(slope)
    return LaneBorders(stations, _borders(np.stack(middles, -1), LANE_WIDTH), _borders(np.stack(slopes, -1), 0.0))


def _stations(reference: LaneCurve) -> Float64[np.ndarray, " n"]:
    """Arc lengths at steps of at most 0.5 m; every fourth is one of a point that netconvert puts on the curve [m]."""
    starts = np.cumsum([0.0, *reference.lengths])
    parts = [
        np.linspace(start, end, _STEPS * int(np.ceil((end - start) / _CHORD)), endpoint=False)
        for start, end in itertools.pairwise(starts.tolist())
    ]
    return np.concatenate([*parts, starts[-1:]])


def have_usual_widths(borders: LaneBorders) -> bool:
    """Whether all lanes are as wide as lanes are."""
    widths = -np.diff(borders.offsets, axis=1)
    return bool((widths > _LEAST_WIDTH).all() and (widths < _MOST_WIDTH).all())


def at_fewer_stations(borders: LaneBorders) -> LaneBorders:
    """Nearly the same borders, with as few cubic pieces as need be.

    They meet at points that netconvert puts on the reference line. Where they met beside such a point, it would make
    two points nearly one on the inner side of a bend, and find a steep grade between them.
    """
    rows, spans = {0, len(borders.stations) - 1}, [(0, len(borders.stations) - 1)]
    while spans:
        first, last = spans.pop()
        inner = slice(first, last + 1)
        between = cubic_values(cubic(borders, first, last), borders.stations[inner] - borders.stations[first])
        error = np.abs(between - borders.offsets[inner]).max(1)
        if error.max() > _TOLERANCE and last - first > _STEPS:
            worst = first + _STEPS * (1 + int(error[_STEPS:-1:_STEPS].argmax()))
            rows.add(worst)
            spans += [(first, worst), (worst, last)]
    return LaneBorders(*(table[sorted(rows)] for table in borders))


def _parallel_at_ends(stations: np.ndarray, offsets: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets that do not change at both ends, where the ways through junctions begin, and their slopes."""
    reach = min(_PARALLEL_LENGTH, stations[-1] / 2)
    moved, turned = offsets.copy(), slopes.copy()
    for at, row in ((0.0, 0), (stations[-1], -1)):
        step = stations - at
        rest = np.clip(1 - np.abs(step) / reach, 0.0, 1.0)
        moved -= slopes[row] * step * rest**2
        turned -= slopes[row] * (rest**2 - 2 * np.abs(step) / reach * rest)
    return moved, turned


def _borders(middles: np.ndarray, width: float) -> np.ndarray:
    """Borders with the middles of the lanes halfway between them, and widths as near to the usual one as can be."""
    count = middles.shape[1]
    signs = (-1.0) ** np.arange(count)
    rest = np.zeros_like(middles)  # each width is the first one times its sign, and this
    for k in range(1, count):
        rest[:, k] = 2 * (middles[:, k - 1] - middles[:, k]) - rest[:, k - 1]
    first = (signs * (width - rest)).mean(1)
    lane_widths = signs * first[:, None] + rest
    left = middles[:, 0] + lane_widths[:, 0] / 2
    return np.column_stack([left, left[:, None] - np.cumsum(lane_widths, 1)])


def cubic(borders: LaneBorders, first: int, last: int) -> Float64[np.ndarray, "4 borders"]:
    """Coefficients a, b, c, d of the polynomials between two rows, in meters from the first one."""
    size = borders.stations[last] - borders.stations[first]
    y0, y1, m0, m1 = borders.offsets[first], borders.offsets[last], borders.slopes[first], borders.slopes[last]
    rise = (y1 - y0) / size
    return np.stack([y0, m0, (3 * rise - 2 * m0 - m1) / size, (m0 + m1 - 2 * rise) / size**2])


def cubic_values(
    coefficients: Float64[np.ndarray, "4 ..."], places: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n ..."]:
    """Values of polynomials at places from their start [m]."""
    return np.stack([places**k for k in range(4)], -1) @ coefficients
