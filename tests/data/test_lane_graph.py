import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.data.lane_graph import build_graph, index_segments, nearest_lane
from scjax.data.readers.scene_json import read_log
from scjax.scene import MapLane, Signal
from scjax.scene.lane_chains import merge_degree2_chains
from tests.factories import scene_files
from tests.factories.logs import example_log, straight_lane


def graph_of(tmp_path, **changes):
    return build_graph(read_log(scene_files.write_scene_file(tmp_path, scene_files.scene_content(**changes))))


def test_build_graph_merges_chains_and_keeps_forks(tmp_path):
    graph = graph_of(tmp_path)
    # 1, 2, 3, 4 and 5+6; the bike lane is gone.
    assert graph.num_lanes == 5
    assert sorted(map(tuple, graph.successors)) == [(0, 1), (0, 2)]
    np.testing.assert_allclose(graph.lane_lengths, [150, 150, 100, 300, 300], atol=0.1)
    merged = graph.points[graph.offsets[4] : graph.offsets[5]]
    assert len(np.unique(merged[:, 0])) == len(merged)  # the shared point is there once


@pytest.mark.parametrize(("gap", "lanes"), [(0.04, 1), (0.06, 2)])
def test_build_graph_joins_up_to_five_centimeters(tmp_path, gap, lanes):
    graph = graph_of(tmp_path, map=[scene_files.lane(1, (0, 0), (20, 0)), scene_files.lane(2, (20 + gap, 0), (40, 0))])
    assert graph.num_lanes == lanes and len(graph.successors) == 0


def test_build_graph_prefers_recorded_topology(tmp_path):
    lanes = [
        scene_files.lane("a", (0, 0), (20, 0), successors=["c", "not here"], predecessors=[]),
        scene_files.lane("b", (0, 5), (20.5, 0.5), successors=[], predecessors=[]),
        scene_files.lane("c", (20.5, 0), (40, 9), successors=[], predecessors=["b"]),
    ]
    graph = graph_of(tmp_path, map=lanes, has={"topology": "given"})
    assert sorted(map(tuple, graph.successors)) == [(0, 2), (1, 2)]


def test_build_graph_drops_duplicates_and_points(tmp_path):
    double = scene_files.lane(1, (0, 0), (10, 0))
    double |= {key: [double[key][0], *double[key]] for key in "xyz"}
    graph = graph_of(tmp_path, map=[double, {**scene_files.lane(2, (0, 9), (5, 9)), "x": [1], "y": [9], "z": [0]}])
    assert graph.num_lanes == 1 and len(graph.points) == 21


def test_build_graph_refuses_maps_without_lanes(tmp_path):
    with pytest.raises(ValueError, match="no lane with two distinct points"):
        graph_of(tmp_path, map=[scene_files.lane(1, (0, 0), (9, 0)) | {"subtype": "bike_lane"}])


def test_build_graph_signals_of_merged_lanes(tmp_path):
    graph = graph_of(tmp_path)
    assert graph.signals[1, [0, 19, 20]].tolist() == [Signal.GO, Signal.GO, Signal.STOP]
    assert not graph.signals[[0, 2, 3, 4]].any()


@given(st.sets(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=16))
@settings(max_examples=200, deadline=None)
def test_merge_degree2_chains_properties(joins):
    chains, successors = merge_degree2_chains(8, joins)
    assert sorted(lane for chain in chains for lane in chain) == list(range(8))
    last, first = {chain[-1]: k for k, chain in enumerate(chains)}, {chain[0]: k for k, chain in enumerate(chains)}
    inner = {(a, b) for chain in chains for a, b in itertools.pairwise(chain)}
    assert inner <= joins
    # Every join is inside a chain or between an end and a start.
    assert {(last[i], first[j]) for i, j in joins - inner} == set(map(tuple, successors))
    # Nothing is left to merge, but closed rings.
    out, into = (
        np.bincount(successors[:, 0], minlength=len(chains)),
        np.bincount(successors[:, 1], minlength=len(chains)),
    )
    assert all(i == j or out[i] != 1 or into[j] != 1 for i, j in successors)


def test_merge_degree2_chains_ring():
    chains, successors = merge_degree2_chains(4, {(3, 1), (1, 2), (2, 3)})
    assert chains == [[0], [1, 2, 3]] and successors.tolist() == [[1, 1]]


def test_infer_neighbors(tmp_path):
    graph = graph_of(tmp_path)
    # 4 is to the left of 1 and of 2; 5+6 comes the other way; 3 turns away.
    assert {(3, 0), (3, 1)} <= set(map(tuple, graph.neighbors))
    assert not any(4 in pair for pair in graph.neighbors.tolist())
    span = graph.overlap_spans[[tuple(pair) for pair in graph.neighbors].index((3, 1))]
    np.testing.assert_allclose(span, [150, 300, 0, 150], atol=2.0)


def test_recorded_neighbors_of_merged_lanes(tmp_path):
    def lane(name, start, end, left=(), right=(), successors=()):
        return scene_files.lane(
            name,
            start,
            end,
            left_neighbors=list(left),
            right_neighbors=list(right),
            successors=list(successors),
            predecessors=[],
        )

    lanes = [
        lane("a", (0, 0), (20, 0), successors=["b"]),
        lane("b", (20, 0), (40, 0), left=[["c", 10, 30, 20, 40], ["d", 0, 40, 0, 40]]),
        lane("c", (15, 3.5), (35, 3.5), right=[["b", 20, 40, 10, 30]]),
        lane("d", (40, -3.5), (20, -3.5)),
    ]
    graph = graph_of(tmp_path, map=lanes, has={"topology": "given"})
    assert graph.neighbors.tolist() == [[1, 0]]
    np.testing.assert_allclose(graph.overlap_spans, [[10, 20, 25, 35]])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_nearest_lane_is_exact(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-40, 40, (6, 2, 2))
    lanes = [scene_files.lane(k, a, b, spacing=rng.choice([0.5, 7.0])) for k, (a, b) in enumerate(corners)]
    graph = graph_of(tmp_path_factory.mktemp("nearest"), map=lanes)
    places = rng.uniform(-60, 60, (20, 2))
    distance, _, z = nearest_lane(index_segments(graph), places, candidates=4)
    start, delta = corners[:, 0], corners[:, 1] - corners[:, 0]
    ratio = (((places[:, None] - start) * delta).sum(-1) / (delta**2).sum(-1)).clip(0, 1)
    exact = np.linalg.norm(places[:, None] - start - ratio[..., None] * delta, axis=-1).min(1)
    np.testing.assert_allclose(distance, exact, atol=1e-6)
    np.testing.assert_allclose(z, 10.0)


def test_merged_lanes_end_behind_the_junction_of_their_signal_on_request():
    """Lanes a, b, ... follow each other; "b" and, 30 m behind it, "d" have signals of two junctions."""
    names = "abcde"
    lanes = tuple(
        straight_lane(
            name,
            30 * k,
            30 * k + 30,
            0,
            predecessors=tuple(names[max(k - 1, 0) : k]),
            successors=tuple(names[k + 1 : k + 2]),
        )
        for k, name in enumerate(names)
    )
    states = np.array([[Signal.GO] * 10, [Signal.STOP] * 10])
    log = example_log(
        lanes=lanes, signal_lane_ids=("b", "d"), signal_states=states, signal_positions=np.full((2, 3), np.nan)
    )
    merged, apart = build_graph(log), build_graph(log, split_at_signals=True)
    assert merged.signals[:, 0].tolist() == [Signal.GO]  # the second signal is lost
    assert apart.signals[:, 0].tolist() == [Signal.GO, Signal.STOP, Signal.UNKNOWN]
    assert apart.successors.tolist() == [[0, 1], [1, 2]]
    np.testing.assert_allclose(apart.lane_lengths, [60, 60, 30])


def lanes_with_bend(radius: float, length: float = 60.0) -> tuple[MapLane, ...]:
    """A straight lane of ``length`` [m], a quarter circle to the left, and another straight lane."""
    angle = np.linspace(0, np.pi / 2, 30)
    bend = radius * np.stack([np.sin(angle), 1 - np.cos(angle)], -1)
    lines = [[[-length, 0.0], [0.0, 0.0]], bend, [[radius, radius], [radius, radius + length]]]
    return tuple(
        MapLane(
            str(k),
            "surface_street",
            np.column_stack([line, np.zeros(len(line))]),
            predecessors=(str(k - 1),) if k else (),
            successors=(str(k + 1),) if k < 2 else (),
        )
        for k, line in enumerate(lines)
    )


@pytest.mark.parametrize(
    ("radius", "length", "num_apart"), [(6.0, 60.0, 3), (60.0, 60.0, 1), (4.0, 20.0, 3), (15.0, 12.0, 1)]
)
def test_bends_alone_keeps_sharp_bends_only_apart(radius, length, num_apart):
    log = example_log(
        lanes=lanes_with_bend(radius, length),
        signal_lane_ids=(),
        signal_states=np.zeros((0, 10), int),
        signal_positions=np.zeros((0, 3)),
    )
    assert build_graph(log).num_lanes == 1
    assert build_graph(log, bends_alone=True).num_lanes == num_apart


def test_signals_alone_ends_lanes_before_a_signal():
    signal = {
        "signal_lane_ids": ("1",),
        "signal_states": np.full((1, 10), Signal.GO),
        "signal_positions": np.full((1, 3), np.nan),
    }
    log = example_log(lanes=lanes_with_bend(60.0), **signal)
    graph = build_graph(log, split_at_signals=True, signals_alone=True)
    assert graph.signals[:, 0].tolist() == [Signal.UNKNOWN, Signal.GO, Signal.UNKNOWN]
