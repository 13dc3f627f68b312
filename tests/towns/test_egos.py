import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.scene import AgentType
from scjax.scene.boxes import overlaps
from scjax.towns.egos import STEPS_AHEAD, STEPS_BACK, box_depth, choose_egos, overlapping_places
from tests.factories.town_traffic import fork_traffic, straight_track


@given(st.lists(st.tuples(*[st.floats(-4, 4)] * 3, st.floats(1, 9), st.floats(0.5, 3)), min_size=2, max_size=6))
@settings(deadline=None)
def test_box_depth_is_positive_where_boxes_overlap(rows):
    xy, heading, sizes = np.array(rows)[:, :2], np.array(rows)[:, 2], np.array(rows)[:, 3:]
    agents = np.zeros((len(rows), 9))
    agents[:, :2], agents[:, 4], agents[:, 5], agents[:, 6:8] = xy, np.cos(heading), np.sin(heading), sizes
    i, j = np.triu_indices(len(rows), 1)
    depth = box_depth(xy, heading, sizes, i, j)
    clear = np.abs(depth) > 1e-5
    np.testing.assert_array_equal((depth > 0)[clear], overlaps(agents)[i, j][clear])


def test_overlapping_places_are_those_of_boxes_in_each_other():
    traffic = fork_traffic(straight_track("a"), straight_track("b", x=4.0), straight_track("c", x=40.0))
    assert sorted(overlapping_places(traffic, 0)[:, 0]) == [0.0, 4.0]


def test_people_may_stand_close_and_bridges_may_cross():
    above = straight_track("d", x=1.0)
    above.positions[:, 2] += 5.0
    person = {"agent_type": AgentType.PEDESTRIAN, "size": (0.7, 0.7, 1.7)}
    crowd = straight_track("p", x=30.0, **person), straight_track("q", x=30.2, **person)
    assert not len(overlapping_places(fork_traffic(straight_track("a"), above, *crowd), 0))


def test_egos_are_there_all_the_time_and_apart():
    tracks = [straight_track(str(k), x=20.0 * k, speed=0.0) for k in range(8)]
    late = straight_track("late", start=STEPS_BACK + 10, y=30.0)
    traffic = fork_traffic(*tracks, late, steps=2 * (STEPS_BACK + STEPS_AHEAD) + 50)
    egos = choose_egos(traffic, 10, 0)
    assert len(egos) and set(egos[:, 0]) == {20, 120}
    assert traffic.names.index("late") not in egos[egos[:, 0] == 20, 1]
    for step in (20, 120):
        x = [20.0 * item for item in egos[egos[:, 0] == step, 1] if item < 8]
        assert np.diff(sorted(x)).min(initial=100.0) >= 60.0


def test_egos_keep_away_from_overlapping_boxes():
    tracks = [
        straight_track("a", speed=0.0),
        straight_track("b", x=1.0, speed=0.0),
        straight_track("c", x=300, speed=0.0),
    ]
    assert [traffic_row for _, traffic_row in choose_egos(fork_traffic(*tracks), 10, 0)] == [2, 2]


def test_small_vehicles_are_no_egos():
    bike = straight_track("m", size=(2.1, 0.8, 1.5), speed=0.0)
    assert not len(choose_egos(fork_traffic(bike), 10, 0))
