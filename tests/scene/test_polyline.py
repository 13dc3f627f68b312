"""Points along polylines."""

from __future__ import annotations

import numpy as np

from scjax.scene.polyline import cubic_between, spread_lines, spread_points


def test_spread_lines_are_the_spread_points_of_each_line():
    rng = np.random.default_rng(0)
    lines = [np.cumsum(rng.uniform(0, 3, (n, 3)), 0) + 1e4 for n in (2, 9, 30)]
    lines += [np.array([[0.0, 0, 1], [12, 0, 1]]), np.array([[5.0, 5, np.nan], [5, 9, np.nan]]), np.ones((2, 3))]
    points, counts = spread_lines(lines, 2.0)
    alone = [spread_points(line, 2.0) for line in lines]
    assert counts.tolist() == [len(line) for line in alone]
    np.testing.assert_allclose(points, np.concatenate(alone), atol=1e-7)


def test_cubics_have_the_places_and_directions_of_their_ends():
    start, stop = np.array([1.0, 2.0, np.nan]), np.array([9.0, 5.0, 3.0])
    curve = cubic_between(start, np.array([1.0, 0.0]), stop, np.array([0.0, 1.0]), 0.01)
    np.testing.assert_array_equal(curve[[0, -1]], [start, stop])
    steps = np.diff(curve[:, :2], axis=0)
    assert np.abs(np.arctan2(steps[[0, -1], 1], steps[[0, -1], 0]) - [0.0, np.pi / 2]).max() < 0.01
    assert np.hypot(*steps.T).max() < 0.02 and np.abs(curve[1:, 2] - 3.0).max() < 1e-9
