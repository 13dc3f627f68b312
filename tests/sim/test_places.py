"""The lanes that agents follow at the start."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.sim.preparation import prepare
from tests.factories.maps import map_lane
from tests.factories.road_maps import agent, road, with_agents


def _is_parked(y: float, width: float) -> bool:
    """Whether a car that stands ``y`` [m] to the left of its lane is parked; oncoming traffic has its lane ``width``
    [m] to the left."""
    oncoming = map_lane("back", (100.0, width, 0.0), (0.0, width, 0.0))
    map = with_agents([road(100.0), oncoming], [agent(50.0, y)])
    return bool(prepare(map, 0, np.random.default_rng(0)).places.is_parked[0])


@pytest.mark.parametrize("y", [0.0, 1.8])
def test_who_stands_in_the_middle_of_a_road_is_not_parked(y):
    assert not _is_parked(y, 3.6)


@pytest.mark.parametrize("width", [2.5, 3.6])
def test_who_stands_at_the_edge_of_a_road_is_parked(width):
    assert _is_parked(-1.8, width)


def test_who_stands_between_two_lanes_of_one_direction_is_not_parked():
    map = with_agents([road(100.0), road(100.0, 3.6, "left")], [agent(50.0, 1.75), agent(20.0, -1.8)])
    assert prepare(map, 0, np.random.default_rng(0)).places.is_parked[:2].tolist() == [False, True]
