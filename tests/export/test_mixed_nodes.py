"""Places where several lanes end and several begin, in OpenDRIVE files."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.export.base import Losses
from scjax.export.opendrive import road_network
from scjax.export.roads.lane_network import LaneNetwork
from scjax.export.roads.lane_nodes import NodeKind, lane_nodes
from scjax.export.roads.mixed_nodes import SHORT_LENGTH, split_mixed_nodes
from scjax.scene import MapLane
from tests.factories.exports import mixed_node_log

IN, OUT = (0, 1), (2, 3)


def network(pairs, kinds=("surface_street",) * 4) -> LaneNetwork:
    """Two lanes that end at the origin and two that begin there, 20 m long."""
    ends = [((-20, -2), (0, 0)), ((-20, 2), (0, 0)), ((0, 0), (20, -3)), ((0, 0), (20, 3))]
    lines = [np.linspace(np.array([*a, 1.0]), np.array([*b, 1.0]), 21) for a, b in ends]
    lanes = tuple(MapLane(str(row), kind, line) for row, (kind, line) in enumerate(zip(kinds, lines, strict=True)))
    successors = tuple(tuple(b for a, b in pairs if a == row) for row in range(4))
    predecessors = tuple(tuple(a for a, b in pairs if b == row) for row in range(4))
    return LaneNetwork(lanes, tuple(lines), successors, predecessors, ((),) * 4, ((),) * 4)


def reached(some: LaneNetwork) -> set[tuple[int, int]]:
    """Pairs of the first four lanes of which one leads to the other, perhaps along a lane that is new."""
    pairs = set(some.pairs)
    through = {(a, d) for a, b in pairs for c, d in pairs if b == c and b >= 4}
    return {(a, b) for a, b in pairs | through if max(a, b) < 4}


PAIRS = {
    "all": [(0, 2), (0, 3), (1, 2), (1, 3)],
    "some": [(0, 2), (0, 3), (1, 3)],
    "to itself": [(0, 0), (0, 2), (1, 0)],
}


@pytest.mark.parametrize("pairs", PAIRS.values(), ids=PAIRS)
def test_lanes_lead_where_they_led(pairs):
    before, losses = network(pairs), Losses()
    assert [node.kind for node in lane_nodes(before, Losses())] == [NodeKind.MIXED]
    after = split_mixed_nodes(before, losses)
    assert reached(after) == set(pairs)
    assert NodeKind.MIXED not in {node.kind for node in lane_nodes(after, Losses())}
    assert {(a, b) for b, some in enumerate(after.predecessors) for a in some} == set(after.pairs)
    assert len(after.left) == len(after.right) == len(after.lanes)
    assert sum(losses.values()) == 1


@pytest.mark.parametrize("name", ["all", "some"])
def test_lanes_that_follow_each_other_meet_and_their_other_ends_stay(name):
    before = network(PAIRS[name])
    after = split_mixed_nodes(before, Losses())
    for i, j in after.pairs:
        np.testing.assert_allclose(after.lines[i][-1], after.lines[j][0], atol=1e-9)
    for row in (*IN, *OUT):
        far = 0 if row in IN else -1
        np.testing.assert_array_equal(after.lines[row][far], before.lines[row][far])
    for line in after.lines[4:]:
        assert np.linalg.norm(line[-1] - line[0]) == pytest.approx(SHORT_LENGTH, rel=0.05)


def test_lanes_of_two_types_share_no_lane():
    pairs = PAIRS["all"]
    after = split_mixed_nodes(network(pairs, ("surface_street", "bike_lane") * 2), Losses())
    assert reached(after) == set(pairs) and len(after.lanes) == 8
    assert [lane.lane_type for lane in after.lanes[4:]] == ["surface_street", "bike_lane"] * 2


def test_other_places_stay_as_they_are():
    before = network([(0, 2), (1, 2)])
    assert split_mixed_nodes(before, Losses()) is before


@pytest.mark.parametrize("is_full", [False, True])
def test_roads_lead_from_lane_to_lane(is_full):
    log = mixed_node_log(is_full)
    roads = road_network(log, Losses()).roads
    planned = {lane.road.id: lane.road for road in roads for lane in road.lanes}
    follows = {(road.before, road.id) for road in planned.values()} | {(id, road.after) for id, road in planned.items()}

    def lanes_after(id: int) -> set[int]:
        """First lanes of the roads at the end of every way from a road."""
        following = {b for a, b in follows if a == id and b}
        return set().union(*map(lanes_after, following)) if following else {planned[id].lane}

    names = [lane.id for lane in log.lanes]
    for road in planned.values():
        if road.lane < 2 and not (road.before or road.junction_before):
            found = {names[lane] for lane in lanes_after(road.id)}
            assert found == set(log.lanes[road.lane].successors)
