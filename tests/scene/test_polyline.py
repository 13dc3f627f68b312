"""Points along polylines."""

from __future__ import annotations

import numpy as np

from scjax.scene.polyline import cumulative_length, spread_lines, spread_points, thinned


def test_spread_lines_are_the_spread_points_of_each_line():
    rng = np.random.default_rng(0)
    lines = [np.cumsum(rng.uniform(0, 3, (n, 3)), 0) + 1e4 for n in (2, 9, 30)]
    lines += [np.array([[0.0, 0, 1], [12, 0, 1]]), np.array([[5.0, 5, np.nan], [5, 9, np.nan]]), np.ones((2, 3))]
    points, counts = spread_lines(lines, 2.0)
    alone = [spread_points(line, 2.0) for line in lines]
    assert counts.tolist() == [len(line) for line in alone]
    np.testing.assert_allclose(points, np.concatenate(alone), atol=1e-7)


def test_thinned_lines_keep_their_ends_and_have_long_steps():
    rng = np.random.default_rng(1)
    line = np.cumsum(rng.uniform(0.0, 0.3, (40, 3)), 0)
    rest = thinned(line, 0.5)
    np.testing.assert_array_equal(rest[[0, -1]], line[[0, -1]])
    arc = cumulative_length(line)
    rows = [int(np.flatnonzero((line == point).all(1))[0]) for point in rest]
    assert np.diff(arc[rows]).min() >= 0.5 and 2 < len(rest) < 40
    np.testing.assert_array_equal(thinned(line[:2], 0.5), line[:2])
