import numpy as np

from scjax.towns.sumo_network import SumoConnection, read_network
from tests.factories.town_traffic import write_net


def test_read_network_reads_lanes_and_their_origin(tmp_path):
    lanes = read_network(write_net(tmp_path)).lanes
    assert lanes["-1_0"].origin == ("1", -1) and lanes[":9_0_0"].origin is None
    assert lanes["-1_0"].length == 94 and lanes["-1_0"].points.tolist() == [[0, 0], [94, 0]]
    assert [lane.id for lane in lanes.values() if lane.is_internal] == [":9_0_0", ":9_2_0", ":9_1_0"]


def test_read_network_knows_who_may_use_a_lane(tmp_path):
    lanes = read_network(write_net(tmp_path)).lanes
    assert lanes["-1_0"].has_cars and not lanes["-1_0"].has_people
    assert lanes["-3_0"].has_cars and lanes["-3_0"].has_people
    assert not lanes[":9_c0_0"].has_cars


def test_read_network_joins_the_parts_of_a_way(tmp_path):
    assert read_network(write_net(tmp_path)).connections == [
        SumoConnection("-1_0", "-2_0", (":9_0_0", ":9_2_0"), ("9", 0)),
        SumoConnection("-1_0", "-3_0", (":9_1_0",), ("9", 1)),
    ]


def test_signal_program_repeats_its_phases(tmp_path):
    program = read_network(write_net(tmp_path)).programs["9"]
    times = np.array([5.0, 24.9, 25.0, 28.0, 44.9, 45.0, 4.9])
    assert program.states_at(times) == ["Gr", "Gr", "yr", "rG", "rG", "Gr", "rG"]
