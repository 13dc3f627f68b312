from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scjax.data.readers.opendrive.lane_lines import LaneKey
from scjax.towns.lane_paths import LanePath, find_way, match_lanes, project
from scjax.towns.sumo_network import read_network
from tests.factories.town_traffic import fork_map, write_net


@pytest.fixture
def paths(tmp_path) -> dict[str, LanePath]:
    return match_lanes(read_network(write_net(tmp_path)), fork_map(), lambda key: True)


def test_lanes_of_roads_lie_on_our_lanes(paths):
    assert paths["-1_0"].keys == (LaneKey("1", 0, -1),) and paths["-2_0"].keys == (LaneKey("2", 0, -1),)
    np.testing.assert_allclose(paths["-1_0"].at(np.array([0.0, 50.0, 94.0]))[:, 0], [0, 50, 94])
    # SUMO's lane begins 5 m behind the junction, and is 0.3 m aside: we stay on our own line.
    np.testing.assert_allclose(paths["-2_0"].at(np.array([0.0, 95.0]))[:, :2], [[125, 0], [220, 0]], atol=1e-6)
    assert paths["-2_0"].offset == pytest.approx(0.3)


def test_ways_through_junctions_begin_and_end_where_the_lanes_do(paths):
    straight, second, left = paths[":9_0_0"], paths[":9_2_0"], paths[":9_1_0"]
    assert [key.road for key in straight.keys] == ["1", "4", "2"] and [key.road for key in left.keys] == ["1", "5", "3"]
    np.testing.assert_allclose(straight.at(np.array([0.0]))[0, :2], [94, 0], atol=1e-6)
    np.testing.assert_allclose(straight.at(np.array([20.0])), second.at(np.array([0.0])), atol=1e-6)
    np.testing.assert_allclose(second.at(np.array([11.0]))[0, :2], [125, 0], atol=1e-6)
    np.testing.assert_allclose(left.at(np.array([22.0]))[0, :2], [110, 14], atol=1e-6)


def test_way_turns_with_our_lane(paths):
    poses = paths[":9_1_0"].at(np.linspace(0, 22, 40))
    inside = (poses[:, 0] > 101) & (poses[:, 1] < 9)
    np.testing.assert_allclose(np.hypot(poses[inside, 0] - 100, poses[inside, 1] - 10), 10, atol=0.01)


def test_lanes_that_are_not_for_cars_are_not_matched(tmp_path):
    network = read_network(write_net(tmp_path))
    assert not match_lanes(network, fork_map(), lambda key: False)


def test_find_way_follows_the_links():
    road_map = fork_map()
    assert find_way(LaneKey("1", 0, -1), LaneKey("3", 0, -1), road_map) == [
        LaneKey("1", 0, -1),
        LaneKey("5", 0, 1),
        LaneKey("3", 0, -1),
    ]
    assert find_way(LaneKey("2", 0, -1), LaneKey("1", 0, -1), road_map) is None


def test_places_beyond_the_ends_go_straight_on(paths):
    poses = paths["-1_0"].at_places(np.array([-3.0, 104.0]))
    np.testing.assert_allclose(poses[:, :2], [[-3, 0], [104, 0]], atol=1e-6)


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=8))
def test_project_finds_the_nearest_place(queries):
    line = np.array([[-20.0, 0, 0], [0, 5, 0], [10, 5, 0], [10, -30, 0]])
    distance, place, _ = project(np.array(queries), line)
    dense = np.concatenate([np.linspace(a, b, 2001)[:, :2] for a, b in pairwise(line)])
    expected = np.hypot(*(np.array(queries)[:, None] - dense).transpose(2, 0, 1)).min(1)
    np.testing.assert_allclose(distance, expected, atol=0.02)
    arcs = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))])
    here = np.stack([np.interp(place, arcs, column) for column in line[:, :2].T], -1)
    np.testing.assert_allclose(np.hypot(*(here - queries).T), distance, atol=1e-6)
