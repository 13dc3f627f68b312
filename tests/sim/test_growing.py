"""A closed loop whose map grows ahead of the driven agent, with the model that ships."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.scene import AgentType, validate_log, validate_map
from scjax.sim import growing
from scjax.sim.drive import drive
from scjax.sim.growing import _route_rows, arrivals_in_the_way, bodies_in_the_way, with_first_stop_lines
from scjax.sim.preparation import prepare
from tests.factories.few_programs import use_few_programs
from tests.factories.maps import map_lane, two_tile_map
from tests.factories.road_maps import agent, road, with_agents

FEW = {"candidates": 2, "retries": 0}


@pytest.fixture(scope="module")
def source():
    map = two_tile_map()
    cars = np.array([agent(45.0, -2.0, speed=9.0), agent(20.0, -2.0, speed=9.0)])
    tiles = tuple(dataclasses.replace(tile, agent_ids=()) for tile in map.tiles)
    return dataclasses.replace(
        map, tiles=tiles, agents=cars, agent_ids=("ego", "other"), agent_types=np.zeros(2, np.int32)
    )


@pytest.fixture(scope="module")
def left_out() -> set[str]:
    """Ids of agents of new tiles that the drive of ``result`` leaves out."""
    return set()


@pytest.fixture(scope="module")
def result(source, left_out):
    with pytest.MonkeyPatch.context() as patch:
        use_few_programs(patch)
        for rule in (growing.arrivals_in_the_way, growing.arrivals_too_near):
            patch.setattr(growing, rule.__name__, _noted(rule, left_out))
        return drive(0, source, seconds=4.0, actor="ego", grow="", **FEW)


def _noted(rule, found: set[str]):
    def noted(*args):
        names = rule(*args)
        found.update(names)
        return names

    return noted


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


def test_agents_of_new_tiles_join_unless_they_are_in_the_way_or_too_near(result, source, left_out):
    new, driven = set(result.map.agent_ids) - set(source.agent_ids), set(result.log.object_ids)
    assert new & driven and new - driven <= left_out and not left_out & driven


def test_bodies_that_reach_into_a_lane_are_in_the_way():
    cars = [agent(20.0, 0.0), agent(60.0, 2.4, 90.0), agent(100.0, 5.0), agent(140.0, 0.2, 80.0)]
    kinds = [AgentType.VEHICLE, AgentType.VEHICLE, AgentType.VEHICLE, AgentType.STATIC]
    start = prepare(with_agents([road(200.0)], cars, kinds), 0, np.random.default_rng(0))
    assert bodies_in_the_way(start) == {"a1", "a3"}
    assert bodies_in_the_way(start, width=8.0) == {"a1", "a2", "a3"}


def test_people_who_stand_close_beside_a_lane_are_in_the_way():
    """Who stands on the lane walks on, and so does who walks."""
    people = [agent(20.0 * (k + 1), y, size=(0.8, 0.8, 1.7)) for k, y in enumerate((1.9, 1.0, 2.6, 1.9))]
    people[3][3] = 1.2
    start = prepare(with_agents([road(200.0)], people, [AgentType.PEDESTRIAN] * 4), 0, np.random.default_rng(0))
    assert bodies_in_the_way(start) == {"a0"}


def test_new_bodies_that_leave_no_room_beside_old_ones_are_in_the_way():
    places = [agent(60.0, -2.2), agent(66.0, 1.3), agent(66.0, 40.0), agent(120.0, 1.3)]  # parked; beside it; elsewhere
    kinds = [AgentType.VEHICLE, *[AgentType.STATIC] * 3]
    starts = [prepare(with_agents([road(200.0)], places[:n], kinds[:n]), 0, np.random.default_rng(0)) for n in (1, 4)]
    before, after = map(bodies_in_the_way, starts)
    assert before == set() and after == {"a0"}
    assert arrivals_in_the_way(starts[1], {"a1", "a2", "a3"}, after, before) == {"a1"}
    assert arrivals_in_the_way(starts[1], {"a1", "a2", "a3"}, after, after) == set()


def test_of_stop_lines_in_a_row_the_first_stays():
    lanes = [
        map_lane("in", (0.0, 0.0, 0.0), (50.0, 0.0, 0.0), successors=("mid",)),
        map_lane("mid", (50.0, 0.0, 0.0), (80.0, 0.0, 0.0), predecessors=("in",), successors=("out",)),
        map_lane("out", (80.0, 0.0, 0.0), (150.0, 0.0, 0.0), predecessors=("mid",)),
        map_lane("alone", (80.0, 9.0, 0.0), (150.0, 9.0, 0.0)),
    ]
    names = ("mid", "out", "alone")
    places = np.array([[50.0, 0.0, 0.0], [80.0, 0.0, 0.0], [80.0, 9.0, 0.0]])
    map = with_agents(
        lanes, [], signal_lane_ids=names, signal_states=np.array([3, 3, 1], np.int32), signal_positions=places
    )
    after = with_first_stop_lines(map)
    assert after.signal_lane_ids == ("mid", "alone") and after.signal_states.tolist() == [3, 1]
    assert validate_map(after).lanes == map.lanes


@pytest.mark.parametrize(
    ("path", "rows"),
    [
        ((), [0]),
        (("a", "d"), [0, 1, 3]),
        (("a", "c"), [0, 2]),
        (("a", "d", "beyond the network"), [0, 1, 3]),
        (("elsewhere",), [0]),
    ],
)
def test_the_route_leads_as_far_along_the_path_as_the_network_reaches(path, rows):
    successors = np.array([[1, 2], [3, -1], [-1, -1], [0, -1]])
    route = _route_rows(0, successors, (("a",), ("b",), ("c",), ("x", "d")), path)
    assert route[route >= 0].tolist() == rows


@pytest.mark.parametrize("chosen", range(6))
def test_every_lane_of_a_wide_junction_can_be_on_the_path(chosen):
    ends = [(80.0, 6.0 * row - 15.0, 0.0) for row in range(6)]
    names = tuple(f"out{row}" for row in range(6))
    outs = [map_lane(name, (50.0, 0.0, 0.0), end, predecessors=("in",)) for name, end in zip(names, ends, strict=True)]
    lanes = [map_lane("in", (0.0, 0.0, 0.0), (50.0, 0.0, 0.0), successors=names), *outs]
    start = prepare(with_agents(lanes, [agent(10.0, 0.0)]), 0, np.random.default_rng(0))
    first = start.lane_ids.index(("in",))
    route = _route_rows(first, np.asarray(start.network.successors), start.lane_ids, ("in", names[chosen]))
    assert [start.lane_ids[row] for row in route[route >= 0]] == [("in",), (names[chosen],)]
