"""Key points, reach, hops and routes on graphs drawn by hand; what the strict mode promises."""

import math

import numpy as np
import pytest

from scjax.metrics.topology import compact_lanes, degrees, endpoint_gaps, key_points, reach_and_hops, route_length
from scjax.scene import permute
from tests.factories.traffic import lane, scene

MODES = ("compat", "strict")


def figures(graph, mode):
    lanes = compact_lanes(graph)
    adjacency = key_points(lanes, mode)
    reach, hops = reach_and_hops(adjacency)
    return sorted(degrees(adjacency).tolist()), sorted(reach.tolist()), sorted(hops.tolist())


def chain(*ends, joined=()):
    return scene(lanes=[lane(*pair) for pair in ends], joined=joined)


@pytest.mark.parametrize("mode", MODES)
def test_compact_lanes_merge_a_chain(mode):
    graph = chain(((0, 0), (8, 0)), ((8, 0), (16, 0)), ((16, 0), (31, 0)), joined=[(0, 1), (1, 2)])
    assert figures(graph, mode) == ([1, 1], [0, 1], [1])
    lanes = compact_lanes(graph)
    assert lanes.points.shape == (1, 20, 2) and not len(lanes.edges)
    np.testing.assert_allclose(lanes.points[0, :, 0], np.linspace(0, 31, 20), atol=1e-6)
    assert route_length(lanes, mode) == pytest.approx(31)


@pytest.mark.parametrize("mode", MODES)
def test_key_points_of_merging_lanes(mode):
    graph = chain(((-9, 2), (0, 0)), ((-9, -2), (0, 0)), ((0, 0), (9, 0)), joined=[(0, 2), (1, 2)])
    # Two starts that each reach the joint and the end; hops 1, 2, 1, 2, 1.
    assert figures(graph, mode) == ([1, 1, 1, 3], [0, 1, 2, 2], [1, 1, 1, 2, 2])


@pytest.mark.parametrize("mode", MODES)
def test_key_points_of_a_ring(mode):
    corners = [(0, 0), (9, 0), (9, 9), (0, 9)]
    ring = [(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    graph = chain(*ring, joined=[(k, (k + 1) % 4) for k in range(4)])
    assert figures(graph, mode) == ([2], [0], [])


@pytest.mark.parametrize("mode", MODES)
def test_topology_of_one_lane_and_none(mode):
    graph = chain(((3, 0), (9, 0)))
    assert figures(graph, mode) == ([1, 1], [0, 1], [1])
    assert route_length(compact_lanes(graph), mode) == pytest.approx(6)
    nothing = compact_lanes(scene())
    assert figures(scene(), mode) == ([], [], []) and math.isnan(route_length(nothing, mode))


def fan():
    """From lane 0 two equally many lanes lead to lane 3, one way 2 m longer; the ego is halfway along lane 0."""
    lanes = [lane((-10, 0), (10, 0)), lane((10, 0), (20, 0)), lane((10, 0), (20, 0)), lane((20, 0), (30, 0))]
    detour = np.linspace(0, 1, 20)
    lanes[2][:, 1] = np.where(detour < 0.5, detour, 1 - detour) * 6.633  # 12 m instead of 10
    return scene(lanes=lanes, joined=[(0, 1), (0, 2), (1, 3), (2, 3)])


def test_route_takes_fewest_lanes_then_metres():
    graph = fan()
    for order in ([0, 1, 2, 3], [0, 2, 1, 3], [3, 2, 1, 0]):
        lanes = compact_lanes(permute(graph, np.arange(0), np.array(order)))
        assert route_length(lanes, "strict") == pytest.approx(30.5, abs=0.6)  # from a point of lane 0 near the origin
        assert route_length(lanes, "compat") >= route_length(lanes, "strict") - 1e-9


def test_strict_key_points_ignore_lane_order():
    rng = np.random.default_rng(0)
    for _ in range(20):
        ends = rng.uniform(-30, 30, (12, 2, 2))
        joined = {(int(i), int(j)) for i, j in rng.integers(12, size=(14, 2)) if i != j}
        joined = [(i, j) for i, j in joined if (j, i) not in joined]
        graph = chain(*[(tuple(a), tuple(b)) for a, b in ends], joined=joined)
        shuffled = permute(graph, np.arange(0), rng.permutation(12))
        assert figures(graph, "strict") == figures(shuffled, "strict")


def test_endpoint_gaps_measure_end_to_start():
    graph = chain(((0, 0), (8, 0)), ((8, 3), (16, 0)), ((12, 0), (16, 0)), joined=[(0, 1), (0, 2)])
    np.testing.assert_allclose(sorted(endpoint_gaps(compact_lanes(graph))), [3, 4])


def test_compact_lanes_are_idempotent():
    graph = chain(((0, 0), (8, 0)), ((8, 0), (16, 0)), ((16, 0), (31, 0)), joined=[(0, 1), (1, 2)])
    once = compact_lanes(graph)
    compacted = compact_lanes(scene(lanes=[np.c_[line, np.zeros(20)].astype(np.float32) for line in once.points]))
    np.testing.assert_allclose(once.points, compacted.points, atol=1e-5)
