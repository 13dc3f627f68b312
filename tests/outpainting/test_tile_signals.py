"""Signals of new tiles agree with those of the map."""

from __future__ import annotations

import numpy as np

from scjax.outpainting.bends import Joint
from scjax.outpainting.coverage import OpenEnd
from scjax.outpainting.lane_merges import NO_ROW, NewLanes
from scjax.outpainting.tile_signals import tile_signals
from scjax.scene import Signal
from tests.factories.maps import map_lane

UNKNOWN, GO, CAUTION, STOP = Signal.UNKNOWN, Signal.GO, Signal.CAUTION, Signal.STOP
AHEAD = np.linspace((0.0, 0.0, 0.0), (32.0, 0.0, 0.0), 20)
ACROSS = np.linspace((10.0, -20.0, 0.0), (10.0, 20.0, 0.0), 20)


def _joint(lane: int, name: str = "old", at_start: bool = True) -> Joint:
    return Joint(lane, at_start, OpenEnd(name, not at_start, np.zeros(3), 0.0, True))


def _signals(lines, sampled, states, joints=(), rows=None):
    known = {name: map_lane(name, (-30, 0), (0, 0)) for name in states}
    lanes = NewLanes(list(lines), list(range(len(lines))) if rows is None else rows, [], list(joints))
    return tile_signals(np.array(sampled, np.int32), lanes, known, states).tolist()


def test_a_lane_that_goes_on_keeps_its_signal():
    for state in (GO, STOP):
        assert _signals([AHEAD], [GO], {"old": int(state)}, [_joint(0)]) == [state]
        assert _signals([AHEAD], [UNKNOWN], {"old": int(state)}, [_joint(0)]) == [state]


def test_where_a_lane_splits_its_parts_have_no_signal_of_their_own():
    assert _signals([AHEAD, AHEAD + 1], [GO, STOP], {"old": int(STOP)}, [_joint(0), _joint(1)]) == [UNKNOWN, UNKNOWN]


def test_a_lane_that_leads_to_a_signal_of_the_map_shows_its_state_or_none():
    for sampled, expected in ((UNKNOWN, UNKNOWN), (GO, STOP)):
        assert _signals([AHEAD], [sampled], {"old": int(STOP)}, [_joint(0, at_start=False)]) == [expected]


def test_lanes_that_cross_one_on_which_traffic_goes_stop():
    lanes, joints = [AHEAD, ACROSS, ACROSS + np.array([3.5, 0, 0])], [_joint(0)]
    assert _signals(lanes, [STOP, GO, GO], {"old": int(GO)}, joints) == [GO, STOP, STOP]
    assert _signals(lanes, [STOP, CAUTION, STOP], {"old": int(CAUTION)}, joints) == [CAUTION, STOP, STOP]
    assert _signals(lanes, [GO, GO, GO], {"old": int(STOP)}, joints) == [STOP, GO, GO]


def test_signals_of_other_junctions_stay():
    lanes = [AHEAD, ACROSS + np.array([60.0, 0, 0])]
    assert _signals(lanes, [UNKNOWN, GO], {"old": int(GO)}, [_joint(0)]) == [GO, GO]
    assert _signals(lanes, [UNKNOWN, GO], {}) == [UNKNOWN, GO]


def test_the_rest_of_a_lane_that_is_cut_and_added_lanes_have_no_signal():
    lanes = [AHEAD[:9], AHEAD[8:], ACROSS]
    assert _signals(lanes, [STOP], {}, rows=[0, 0, NO_ROW]) == [STOP, UNKNOWN, UNKNOWN]


def test_lanes_straight_on_from_one_place_have_one_light():
    beside = AHEAD + np.array([0.0, 3.5, 0.0])
    assert _signals([AHEAD, beside], [GO, STOP], {}) == [STOP, STOP]
    assert _signals([AHEAD, beside], [STOP, GO], {"old": int(GO)}, [_joint(0)]) == [GO, GO]
    assert _signals([AHEAD, beside], [GO, UNKNOWN], {}) == [GO, UNKNOWN]


def test_turn_arrows_differ_from_the_light_of_lanes_straight_on():
    angles = np.linspace(0.0, np.pi / 2, 20)
    turn = np.stack([10 * np.sin(angles), 10 * (1 - np.cos(angles)), np.zeros(20)], -1)
    for other in (turn, AHEAD + np.array([0.0, 9.0, 0.0]), AHEAD[::-1]):
        assert _signals([AHEAD, other], [GO, STOP], {}) == [GO, STOP]
