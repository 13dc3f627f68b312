"""Measures of maps at seams and elsewhere, on maps written by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.outpainting.measures import kinks_of, measure_zones
from tests.factories.maps import two_tile_map


def _arc(radius: float, turn: float, step: float = 0.1) -> np.ndarray:
    """A straight line of 10 m, an arc, and 10 m more."""
    angles = np.arange(0.0, turn, step / radius)
    arc = np.stack([10 + radius * np.sin(angles), radius * (1 - np.cos(angles))], -1)
    way = np.array([np.cos(turn), np.sin(turn)])
    end = np.array([10 + radius * np.sin(turn), radius * (1 - np.cos(turn))])
    line = np.concatenate([[[0.0, 0.0]], arc, [end], [end + 10 * way]])
    return np.concatenate([line, np.zeros((len(line), 1))], -1)


@pytest.mark.parametrize(("radius", "kinked"), [(6.0, False), (3.0, False), (1.5, True), (0.3, True)])
def test_kinks_are_turns_that_no_car_can_drive(radius, kinked):
    assert (len(kinks_of(_arc(radius, np.pi / 2))) > 0) == kinked


def test_folds_of_short_lanes_are_kinks():
    line = np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0], [0.3, 0.02, 0.0], [1.2, 0.0, 0.0]])
    assert len(kinks_of(line)) and not len(kinks_of(line[[0, 1, 3]]))


def test_what_is_near_a_seam_is_counted_there():
    map = two_tile_map()
    at_seams, elsewhere = measure_zones(map)
    assert (at_seams.ends, elsewhere.ends) == (4, 4) and (at_seams.dead_ends, elsewhere.dead_ends) == (0, 0)
    assert at_seams.length == pytest.approx(2 * 16, abs=3) and at_seams.length + elsewhere.length == pytest.approx(
        256, abs=5
    )
    apart = tuple(dataclasses.replace(lane, predecessors=(), successors=()) for lane in map.lanes)
    at_seams, elsewhere = measure_zones(dataclasses.replace(map, lanes=apart, seams=map.seams))
    assert (at_seams.dead_ends, elsewhere.dead_ends) == (2, 0)  # the new tile covers its front half
    boxes = np.array([[30.0, 0, 0, 0, 1, 0, 4, 2, 1], [31.0, 0, 0, 0, 1, 0, 4, 2, 1], [0.0, 0, 0, 0, 1, 0, 4, 2, 1]])
    crowded = dataclasses.replace(
        map, tiles=(), agents=boxes, agent_ids=("a", "b", "c"), agent_types=np.zeros(3, np.int32)
    )
    at_seams, elsewhere = measure_zones(crowded)
    assert (at_seams.agents, at_seams.overlapping, elsewhere.agents, elsewhere.overlapping) == (2, 2, 1, 0)


def test_vehicles_more_than_a_meter_from_every_lane_of_their_direction_are_beside():
    """The lanes are at y = -2 to the east, and y = 2 to the west."""
    rows = [(0.0, -2.0, 1.0), (0.0, -3.4, 1.0), (0.0, 2.0, 1.0), (0.0, 2.5, -1.0), (34.0, -2.9, 1.0), (34.0, 0.0, 1.0)]
    agents = np.array([[x, y, 0, 0, cos, 0, 4, 2, 1] for x, y, cos in rows])
    ids = tuple(str(row) for row in range(len(rows)))
    map = two_tile_map(agents=agents, agent_ids=ids, agent_types=np.zeros(len(rows), np.int32), tiles=())
    at_seams, elsewhere = measure_zones(map)
    assert (at_seams.vehicles, at_seams.beside, elsewhere.vehicles, elsewhere.beside) == (2, 1, 4, 2)
