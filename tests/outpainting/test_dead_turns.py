"""Turns that lead nowhere are left out, up to where the road has another way; all else stays."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.outpainting.coverage import Coverage
from scjax.outpainting.dead_turns import DeadTurns, without_turns
from scjax.scene import AgentType, Map, MapRoute, MapTile, TileStatus, validate_map
from tests.factories.maps import map_lane

FAR = 1e3


def _junction(known=(), routes=()):
    """A road that splits into a way ahead and a turn of two lanes."""
    lanes = (
        map_lane("road", (0, 0), (20, 0), successors=("ahead", "turn")),
        map_lane("ahead", (20, 0), (50, 0), predecessors=("road",)),
        map_lane("turn", (20, 0), (28, 5), predecessors=("road",), successors=("end",)),
        map_lane("end", (28, 5), (28, 15), predecessors=("turn",)),
    )
    tile = MapTile(
        x=25.0,
        y=0.0,
        z=0.0,
        yaw=0.0,
        status=TileStatus.COMPLETE,
        attempts=1,
        prompt="",
        fault="",
        lane_ids=tuple(lane.id for lane in lanes if lane.id not in known),
        agent_ids=("on the turn", "on the road"),
    )
    box = [0.0, 0.0, 1.0, 0.0, 4.5, 2.0, 1.6]
    return Map(
        lanes=lanes,
        tiles=(tile,),
        routes=routes,
        agent_ids=("on the turn", "on the road"),
        agent_types=np.full(2, AgentType.VEHICLE, np.int32),
        agents=np.array([[28.0, 12.0, *box], [10.0, 0.0, *box]]),
    )


def _ends(map, *names):
    return [end for end in Coverage(map).open_ends(map) if end.lane_id in names and not end.is_start]


def _turns(map, *names, place=(FAR, FAR)):
    ends = _ends(map, *names)
    lanes, staying = DeadTurns(map, ends, *place).of(ends)
    return lanes, {end.lane_id for end in staying}


def test_a_turn_that_leads_nowhere_is_left_out_with_its_vehicle():
    map = _junction()
    lanes, staying = _turns(map, "end")
    assert lanes == {"turn", "end"} and not staying
    less = validate_map(without_turns(map, lanes))
    assert [lane.id for lane in less.lanes] == ["road", "ahead"] and less.agent_ids == ("on the road",)
    assert less.lanes[0].successors == ("ahead",)


def test_one_of_two_ways_stays():
    lanes, staying = _turns(_junction(), "end", "ahead")
    assert (lanes, staying) in (({"turn", "end"}, {"ahead"}), ({"ahead"}, {"end"}))


@pytest.mark.parametrize(
    "kept",
    [
        {"known": ("turn",)},
        {"routes": (MapRoute(lane_ids=("road", "turn", "end"), name="way"),)},
    ],
)
def test_known_lanes_and_routes_stay(kept):
    assert _turns(_junction(**kept), "end") == (set(), {"end"})


def test_the_lane_that_a_window_continues_stays():
    assert _turns(_junction(), "end", place=(28.0, 14.5)) == (set(), {"end"})


def test_nothing_to_leave_out_gives_the_same_map():
    map = _junction()
    assert without_turns(map, set()) is map
