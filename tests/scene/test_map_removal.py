"""Maps without some lanes and agents: nothing names them any longer, all else stays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.scene import LaneNeighbor, validate_map
from scjax.scene.map_removal import remove_from_map
from tests.factories.maps import two_tile_map


def test_nothing_names_what_is_removed():
    map = dataclasses.replace(two_tile_map(), routes=())
    first, *others = map.lanes
    others[0] = dataclasses.replace(others[0], left_neighbors=(LaneNeighbor(first.id),))
    map = dataclasses.replace(map, lanes=(first, *others))
    agents = map.agent_ids[:1]
    less = validate_map(remove_from_map(map, [first.id], agents))
    assert [lane.id for lane in less.lanes] == [lane.id for lane in others]
    assert first.id not in repr(less) and less.agent_ids == map.agent_ids[1:]
    assert np.array_equal(less.agents, map.agents[1:], equal_nan=True)
    assert all(np.array_equal(less.lane_by_id[lane.id].points, lane.points) for lane in others)


def test_removing_nothing_changes_nothing():
    map = two_tile_map()
    same = remove_from_map(map)
    assert same.lanes == map.lanes and same.tiles == map.tiles and same.seams == map.seams


@pytest.mark.parametrize(
    ("lanes", "agents", "message"),
    [
        (["nowhere"], [], "no lane 'nowhere'"),
        ([], ["nobody"], "no agent 'nobody'"),
        (["ahead-0"], [], "is part of route"),
    ],
)
def test_errors_name_what_is_wrong(lanes, agents, message):
    with pytest.raises(ValueError, match=message):
        remove_from_map(two_tile_map(), lanes, agents)
