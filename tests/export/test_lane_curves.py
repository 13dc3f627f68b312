"""Curves through polylines: near to the points, smooth, with the directions that are given; cut and joined exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.export.roads.lane_curves import (
    TOLERANCE,
    LaneCurve,
    curve_frames,
    curve_line,
    cut_curve,
    fit_curve,
    join_curves,
    piece_tangents,
    without_short_bend,
)
from scjax.scene.polyline import cumulative_length


def _wave(amplitude: float, length: float, count: int) -> np.ndarray:
    x = np.linspace(0, length, count)
    return np.column_stack([x, amplitude * np.sin(x / 10), 0.1 * x])


def _fit(line: np.ndarray) -> LaneCurve:
    steps = np.diff(line[:, :2], axis=0)
    return fit_curve(line, *(float(np.arctan2(*steps[k][::-1])) for k in (0, -1)))


def _distances(line: np.ndarray, curve: LaneCurve) -> np.ndarray:
    points, _ = curve_line(curve, 0.02)
    return np.array([np.linalg.norm(points[:, :2] - point, axis=1).min() for point in line[:, :2]])


curves = st.builds(_wave, st.floats(0, 5), st.floats(5, 80), st.integers(5, 60))


@settings(max_examples=20, deadline=None)
@given(line=curves)
def test_fit_passes_near_every_point(line):
    assert _distances(line, _fit(line)).max() <= TOLERANCE + 0.02


@settings(max_examples=20, deadline=None)
@given(line=curves, start=st.floats(-0.3, 0.3), end=st.floats(-0.3, 0.3))
def test_curve_has_the_directions_that_are_given_and_no_kink(line, start, end):
    curve = fit_curve(line, start, end)
    for piece, u, angle in ((curve.pieces[0], 0.0, start), (curve.pieces[-1], 1.0, end)):
        tangent = piece_tangents(piece, np.array([u]))[0]
        np.testing.assert_allclose(np.arctan2(tangent[1], tangent[0]), angle, atol=1e-6)
    ends = np.array([piece_tangents(piece, np.array([0.0, 1.0])) for piece in curve.pieces])
    headings = np.arctan2(ends[..., 1], ends[..., 0])
    np.testing.assert_allclose(headings[1:, 0], headings[:-1, 1], atol=1e-6)


def test_length_is_the_arc_length():
    angle = np.linspace(0, np.pi / 2, 40)
    circle = 20 * np.column_stack([np.sin(angle), 1 - np.cos(angle), np.zeros(40)])
    np.testing.assert_allclose(fit_curve(circle, 0.0, np.pi / 2).length, 10 * np.pi, rtol=1e-3)


@settings(max_examples=20, deadline=None)
@given(line=curves, share=st.floats(0.05, 0.95))
def test_parts_of_a_curve_join_to_the_whole(line, share):
    curve = _fit(line)
    place = share * curve.length
    first, second = cut_curve(curve, 0.0, place), cut_curve(curve, place, curve.length)
    np.testing.assert_allclose([first.length, second.length], [place, curve.length - place], atol=1e-4)
    np.testing.assert_allclose(first.pieces[-1, -1], second.pieces[0, 0], atol=1e-6)
    np.testing.assert_allclose(first.heights[-1, 1], second.heights[0, 1])
    whole, _ = curve_line(join_curves([first, second]), 0.5)
    again, _ = curve_line(curve, 0.5)
    at = np.linspace(0, 1, 50)
    for column in range(3):
        ours, theirs = (
            np.interp(at, cumulative_length(one) / cumulative_length(one)[-1], one[:, column]) for one in (whole, again)
        )
        np.testing.assert_allclose(ours, theirs, atol=0.02)


def test_heights_keep_within_the_tolerance():
    line = _wave(2.0, 60.0, 61)
    line[:, 2] = 3 * np.sin(line[:, 0] / 7)
    points, _ = curve_line(_fit(line), 0.1)
    row = [np.linalg.norm(points[:, :2] - point[:2], axis=1).argmin() for point in line]
    assert np.abs(points[row, 2] - line[:, 2]).max() < 0.05


def test_three_points_make_no_loop():
    line = np.array([[15.15, 58.95, 0], [12.06, 52.79, 0], [8.18, 44.84, 0], [4.16, 36.79, 0]])
    curve = _fit(line)
    np.testing.assert_allclose(curve.length, cumulative_length(line)[-1], rtol=0.01)


@pytest.mark.parametrize("from_end", [False, True])
def test_short_bends_become_straight_from_the_end_that_stays(from_end):
    angle = np.linspace(0.0, 1.0, 12)
    curve = _fit(np.stack([1.5 * np.sin(angle), 1.5 * (1 - np.cos(angle)), angle], -1))
    straight = without_short_bend(curve, from_end)
    assert straight.length == pytest.approx(curve.length)
    arcs = np.array([0.0, curve.length])
    (places, headings), (before, directions) = curve_frames(straight, arcs), curve_frames(curve, arcs)
    row = -1 if from_end else 0
    np.testing.assert_allclose(places[row], before[row], atol=1e-9)
    np.testing.assert_allclose(headings, directions[row], atol=1e-6)


def test_other_curves_keep_their_bends():
    for curve in (_fit(_wave(3.0, 20.0, 30)), _fit(_wave(0.1, 1.5, 8))):
        assert without_short_bend(curve, False) is curve
