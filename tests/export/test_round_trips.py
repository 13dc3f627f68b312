"""What is exported is what our own readers find again, within the precision of each format."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from scjax.data.imports import import_log
from scjax.data.lane_graph import LaneGraph, build_graph
from scjax.export import EXPORTS, export_log
from scjax.scene import NO_EGO, Log, Signal
from tests.factories.exports import crossing_log, two_lane_log
from tests.factories.logs import example_log


def _again(log: Log, format: str, folder) -> Log:
    suffix = EXPORTS[format].suffix
    return import_log(export_log(log, folder / f"file{suffix}", format).paths[0])


def _edges(graph: LaneGraph) -> set[tuple]:
    """Connections as places where they are [dm], with the direction before and after."""
    ends = [(graph.points[graph.offsets[k]], graph.points[graph.offsets[k + 1] - 1]) for k in range(graph.num_lanes)]
    return {
        tuple(np.round(np.concatenate([ends[i][0], ends[i][1], ends[j][1]])[[0, 1, 3, 4, 6, 7]], 0))
        for i, j in graph.successors
    }


def _same_traffic(log: Log, again: Log, rows: list[int], tolerance: float = 1e-6) -> None:
    """Objects ``rows`` of ``log`` are those of ``again`` in order."""
    np.testing.assert_array_equal(again.object_types, log.object_types[rows])
    np.testing.assert_array_equal(again.valid, log.valid[rows])
    seen = again.valid
    for name in ("positions", "headings", "velocities"):
        ours, theirs = getattr(log, name)[rows][seen], getattr(again, name)[seen]
        ours, theirs = (values[..., :2] if name == "positions" else values for values in (ours, theirs))
        np.testing.assert_allclose(theirs, ours, atol=tolerance)
    np.testing.assert_allclose(again.sizes[:, :2], log.sizes[rows, :2], atol=tolerance)


@pytest.mark.parametrize("format", ["scenarionet", "json", "npz"])
def test_traffic_signals_and_topology_come_back(format, tmp_path):
    log = crossing_log()
    again = _again(log, format, tmp_path)
    _same_traffic(log, again, [0, 1])
    assert again.ego_index == 0 and again.object_ids == log.object_ids
    np.testing.assert_allclose(np.diff(again.timestamps), np.diff(log.timestamps))
    assert again.signal_lane_ids == ("straight",)
    np.testing.assert_array_equal(again.signal_states, log.signal_states)
    np.testing.assert_allclose(again.signal_positions, log.signal_positions)
    ours, theirs = ({lane.id: lane for lane in one.lanes} for one in (log, again))
    assert ours.keys() == theirs.keys()
    for name, lane in ours.items():
        np.testing.assert_allclose(theirs[name].points, lane.points)
        assert set(theirs[name].successors) == set(lane.successors)
        assert set(theirs[name].predecessors) == set(lane.predecessors)


@pytest.mark.parametrize("format", ["scenarionet", "json", "npz", "commonroad"])
def test_neighbors_come_back(format, tmp_path):
    log = two_lane_log()
    ours, theirs = build_graph(log), build_graph(_again(log, format, tmp_path))
    np.testing.assert_array_equal(theirs.neighbors, ours.neighbors)
    np.testing.assert_allclose(theirs.overlap_spans, ours.overlap_spans, atol=1e-6)
    assert len(ours.neighbors) == 1


@pytest.mark.parametrize("format", ["opendrive", "commonroad"])
@pytest.mark.parametrize("make", [crossing_log, two_lane_log, example_log])
def test_lane_graph_comes_back(format, make, tmp_path):
    log = make()
    ours, theirs = build_graph(log), build_graph(_again(log, format, tmp_path))
    assert _edges(theirs) == _edges(ours)
    np.testing.assert_allclose(sorted(theirs.lane_lengths), sorted(ours.lane_lengths), atol=0.05)


def test_opendrive_keeps_places_and_heights_of_lanes(tmp_path):
    log = two_lane_log()
    again = _again(log, "opendrive", tmp_path)
    from scipy.spatial import KDTree

    distance, _ = KDTree(np.concatenate([lane.points for lane in log.lanes])).query(
        np.concatenate([lane.points for lane in again.lanes])
    )
    assert distance.max() < 1.05  # half of the spacing of the points
    ours, theirs = (sorted(lane.points[[0, -1]].ravel().tolist() for lane in one.lanes) for one in (log, again))
    np.testing.assert_allclose(theirs, ours, atol=0.05)
    assert {lane.lane_type for lane in again.lanes} == {"freeway"}


@pytest.mark.parametrize("format", ["opendrive", "commonroad"])
def test_signal_controls_the_same_way(format, tmp_path):
    log = crossing_log()
    ours, theirs = (build_graph(one, split_at_signals=True) for one in (log, _again(log, format, tmp_path)))
    again = _again(log, format, tmp_path)
    lane = next(lane for lane in again.lanes if lane.id == again.signal_lane_ids[0])
    assert len(again.signal_lane_ids) == 1 and np.hypot(*lane.points[0, :2]) < 0.01
    assert np.abs(lane.points[:, 1]).max() < 0.01  # straight on, not to the left
    assert ours.num_lanes and theirs.num_lanes


def test_commonroad_keeps_traffic_and_light_states(tmp_path):
    log = crossing_log(ego_index=NO_EGO)
    again = _again(log, "commonroad", tmp_path)
    _same_traffic(log, again, [0, 1], 1e-5)
    np.testing.assert_array_equal(again.signal_states, log.signal_states)
    assert again.dt == pytest.approx(0.1)


def test_commonroad_has_the_ego_as_planning_problem(tmp_path):
    again = _again(crossing_log(), "commonroad", tmp_path)
    assert again.metadata.notes == {"planningProblems, not read": 1}
    _same_traffic(crossing_log(), again, [1], 1e-5)


def test_signal_states_of_commonroad_are_a_cycle(tmp_path):
    states = np.array(
        [[Signal.UNKNOWN, Signal.GO, Signal.GO, Signal.CAUTION, Signal.STOP, Signal.GO] + [Signal.STOP] * 14]
    )
    again = _again(crossing_log(signal_states=states, ego_index=NO_EGO), "commonroad", tmp_path)
    np.testing.assert_array_equal(again.signal_states, states)


def test_log_without_topology_gets_the_inferred_joins(tmp_path):
    log = crossing_log()
    bare = tuple(dataclasses.replace(lane, predecessors=(), successors=()) for lane in log.lanes)
    unknown = dataclasses.replace(log, lanes=bare, has_topology=False)
    for format in ("scenarionet", "opendrive", "commonroad"):
        again = build_graph(_again(unknown, format, tmp_path / format))
        assert _edges(again) == _edges(build_graph(log)), format


def test_recording_is_json_too(tmp_path):
    path = export_log(crossing_log(), tmp_path / "log.json", "json").paths[0]
    assert json.loads(path.read_text())["schema"] == "scene-json-1"


def test_scenarios_of_one_folder_are_listed_together(tmp_path):
    for name in ("one", "two"):
        log = crossing_log(metadata=dataclasses.replace(crossing_log().metadata, scene_id=name))
        export_log(log, tmp_path, "scenarionet")
    from scjax.data.readers.restricted_pickle import load_plain_pickle

    summary = load_plain_pickle((tmp_path / "dataset_summary.pkl").read_bytes())
    mapping = load_plain_pickle((tmp_path / "dataset_mapping.pkl").read_bytes())
    assert sorted(mapping) == sorted(summary) == ["sd_village_scjax-1_one.pkl", "sd_village_scjax-1_two.pkl"]
    assert b"scjax.data" not in (tmp_path / "dataset_summary.pkl").read_bytes()
