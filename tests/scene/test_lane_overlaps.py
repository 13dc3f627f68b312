from __future__ import annotations

import numpy as np
import pytest

from scjax.scene.lane_overlaps import overlap_places


def line(*points) -> np.ndarray:
    return np.array([(*point, 0.0)[:3] for point in points], np.float64)


WAY_IN = line((-20.0, -20.0), (0.0, 0.0), (30.0, 0.0))
WAY_OUT = line((-15.0, 0.0), (15.0, 0.0), (40.0, -20.0))
"""Ways of a roundabout: one enters where the other has not left it yet."""


def test_overlap_places_of_ways_that_weave():
    places = overlap_places([WAY_IN, WAY_OUT])
    assert (np.abs(places[:, 1]) <= 1.0).all()
    assert places[:, 0].min() < 2.0 and places[:, 0].max() > 13.0


@pytest.mark.parametrize(
    "others",
    [
        [WAY_OUT[::-1]],  # the other direction
        [WAY_OUT + np.array([0.0, 0.0, 5.0])],  # a bridge
        [WAY_OUT + np.array([0.0, 1.5, 0.0])],  # beside it
        [line((-20.0, -20.0), (0.0, 0.0), (15.0, 0.0), (40.0, -20.0))],  # parts
        [line((-15.0, 0.0), (30.0, 0.0))],  # meets
        [line((-15.0, 0.0), (6.0, 0.0), (6.0, -20.0))],  # shares less than 8 m
        [line((30.0, 0.0), (60.0, 0.0)), line((0.0, -30.0), (10.0, 30.0))],  # follows, crosses
        [],
    ],
)
def test_overlap_places_are_none_elsewhere(others):
    assert len(overlap_places([WAY_IN, *others])) == 0


def test_overlap_places_without_lanes_are_none():
    assert overlap_places([]).shape == (0, 2)
