"""Points along polylines."""

from __future__ import annotations

import numpy as np

from scjax.scene.polyline import spread_lines, spread_points


def test_spread_lines_are_the_spread_points_of_each_line():
    rng = np.random.default_rng(0)
    lines = [np.cumsum(rng.uniform(0, 3, (n, 3)), 0) + 1e4 for n in (2, 9, 30)]
    lines += [np.array([[0.0, 0, 1], [12, 0, 1]]), np.array([[5.0, 5, np.nan], [5, 9, np.nan]]), np.ones((2, 3))]
    points, counts = spread_lines(lines, 2.0)
    alone = [spread_points(line, 2.0) for line in lines]
    assert counts.tolist() == [len(line) for line in alone]
    np.testing.assert_allclose(points, np.concatenate(alone), atol=1e-7)
