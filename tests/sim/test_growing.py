"""A closed loop whose map grows ahead of the driven agent, with the model that ships."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.scene import validate_log, validate_map
from scjax.sim.drive import drive
from tests.factories.maps import two_tile_map
from tests.factories.road_maps import agent

FEW = {"candidates": 2, "retries": 0, "num_steps": 4}


@pytest.fixture(scope="module")
def source():
    map = two_tile_map()
    cars = np.array([agent(45.0, -2.0, speed=9.0), agent(20.0, -2.0, speed=9.0)])
    tiles = tuple(dataclasses.replace(tile, agent_ids=()) for tile in map.tiles)
    return dataclasses.replace(
        map, tiles=tiles, agents=cars, agent_ids=("ego", "other"), agent_types=np.zeros(2, np.int32)
    )


@pytest.fixture(scope="module")
def result(source):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scjax.generate.batching.BUCKETS", ((16, 28), (61, 100)))
        return drive(0, source, seconds=4.0, actor="ego", grow="", **FEW)


def test_the_map_grows_before_the_way_ends(result, source):
    assert len(result.map.tiles) > len(source.tiles)
    validate_map(result.map)
    log = validate_log(result.log)
    assert log.num_steps == 41 and log.lanes == result.map.lanes
    assert result.actor == "ego" and log.object_ids[log.ego_index] == "ego"


def test_nobody_jumps_when_a_tile_is_added(result):
    for row in range(result.log.num_objects):
        steps = np.flatnonzero(result.log.valid[row])
        moved = np.hypot(*np.diff(result.log.positions[row, steps, :2], axis=0).T)
        limit = 0.1 * np.hypot(*result.log.velocities[row, steps[1:]].T) + 0.4
        assert (moved <= limit).all(), result.log.object_ids[row]


def test_agents_of_new_tiles_join(result, source):
    new = set(result.map.agent_ids) - set(source.agent_ids)
    assert new <= set(result.log.object_ids)
