from itertools import pairwise

import numpy as np
import pytest

from scjax.data.lane_bends import MAX_POINT_TURN, split_bends
from scjax.data.lane_graph import LaneGraph, build_graph
from scjax.scene import LaneNeighbor, MapLane, Signal
from scjax.scene.angles import wrap_to_pi
from scjax.scene.polyline import resample_polyline
from tests.factories.logs import example_log


def _way(radius: float, straight: float = 20.0) -> np.ndarray:
    """A way that runs straight, turns by 90 degrees to the left and runs straight again [points, 3]."""
    angle = np.linspace(0, np.pi / 2, 60)
    bend = radius * np.stack([np.sin(angle), 1 - np.cos(angle)], -1)
    line = np.concatenate([[[-straight, 0.0]], bend, [[radius, radius + straight]]])
    return np.column_stack([line, np.linspace(0, 3, len(line))])


def _graph(*ways: np.ndarray) -> LaneGraph:
    """Ways in a row; the signal of the first is green."""
    lanes = tuple(
        MapLane(str(k), "surface_street", way, successors=(str(k + 1),) if k + 1 < len(ways) else ())
        for k, way in enumerate(ways)
    )
    signal = {"signal_states": np.full((1, 10), Signal.GO), "signal_positions": np.full((1, 3), np.nan)}
    return build_graph(example_log(lanes=lanes, signal_lane_ids=("0",), **signal), split_at_signals=True)


def _most_turn(graph: LaneGraph) -> float:
    """The greatest turn at a point of a lane with as many points as in a scene [rad]."""
    lines = np.split(graph.points, graph.offsets[1:-1])
    steps = [np.diff(resample_polyline(line, 20)[:, :2], axis=0) for line in lines]
    headings = [np.arctan2(step[:, 1], step[:, 0]) for step in steps]
    return max(float(np.abs(wrap_to_pi(np.diff(heading))).max()) for heading in headings)


@pytest.mark.parametrize("radius", [2.5, 4.0, 6.0])
def test_split_bends_leaves_no_sharp_turn_at_a_point(radius):
    graph = _graph(_way(radius))
    assert _most_turn(graph) > MAX_POINT_TURN
    assert _most_turn(split_bends(graph)) <= MAX_POINT_TURN


def test_split_bends_keeps_the_way_and_its_order():
    graph = _graph(_way(3.0), np.array([[3.0, 23.0, 3.0], [3.0, 60.0, 3.0]]))
    cut = split_bends(graph)
    assert cut.num_lanes > graph.num_lanes == 2
    assert sorted(cut.successors.tolist()) == [[k, k + 1] for k in range(cut.num_lanes - 1)]
    lines = np.split(cut.points, cut.offsets[1:-1])
    for first, second in pairwise(lines):
        np.testing.assert_allclose(first[-1], second[0])
    assert sum(cut.lane_lengths) == pytest.approx(sum(graph.lane_lengths))
    states = cut.signals[:, 0].tolist()
    assert states == [Signal.GO] * (len(states) - 1) + [Signal.UNKNOWN]


def test_split_bends_leaves_gentle_and_short_lanes_whole():
    for way in (_way(40.0), _way(1.5, straight=3.0)):
        graph = _graph(way)
        assert split_bends(graph) is graph


def test_split_bends_keeps_neighbors_beside_each_other():
    inner, outer = _way(4.0), _way(7.5)
    outer = outer - [0.0, 3.5, 0.0]
    span = (0, len(inner) - 1, 0, len(outer) - 1)
    lanes = (
        MapLane("in", "surface_street", inner, right_neighbors=(LaneNeighbor("out", *span),)),
        MapLane("out", "surface_street", outer, left_neighbors=(LaneNeighbor("in", *span),)),
    )
    nothing = {"signal_lane_ids": (), "signal_states": np.zeros((0, 10), int), "signal_positions": np.zeros((0, 3))}
    graph = build_graph(example_log(lanes=lanes, **nothing))
    cut = split_bends(graph)
    assert graph.neighbors.tolist() == [[0, 1]] and cut.num_lanes > 2
    for (left, right), (low, high, other_low, other_high) in zip(cut.neighbors, cut.overlap_spans, strict=True):
        assert 0 <= low < high <= cut.lane_lengths[left] + 1e-6
        assert 0 <= other_low < other_high <= cut.lane_lengths[right] + 1e-6
    assert {int(left) for left, _ in cut.neighbors} | {int(right) for _, right in cut.neighbors} == set(
        range(cut.num_lanes)
    )
