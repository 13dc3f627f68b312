import gzip
import json

import numpy as np
import pytest

from scjax.data.readers import LogReader, open_folder
from scjax.data.readers.scene_json import read_log
from scjax.scene import NO_EGO, OTHER_OBJECT, AgentType, LaneNeighbor, Signal
from tests.factories import scene_files


def test_read_log_metadata(tmp_path):
    path = scene_files.write_scene_file(tmp_path)
    metadata = read_log(path).metadata
    assert (metadata.domain, metadata.scene_id, metadata.location_cluster) == ("womd", "hand-made", "village")
    assert (metadata.variant, metadata.source_file) == ("hand", str(path)) and len(metadata.source_sha256) == 64


def test_read_log_objects(tmp_path):
    log = read_log(scene_files.write_scene_file(tmp_path))
    assert log.num_steps == scene_files.STEPS and log.dt == pytest.approx(0.1)
    assert log.ego_index == 0 and log.object_ids[0] == "vehicle (-20, 0)"
    assert log.object_types.tolist() == [AgentType.VEHICLE] * 3 + [
        AgentType.PEDESTRIAN,
        AgentType.STATIC,
        OTHER_OBJECT,
    ]
    np.testing.assert_allclose(log.positions[0, 10], [-10, 0, 10.8])
    np.testing.assert_allclose(log.sizes[1], [6.0, 2.4, 2.5])


def test_read_log_map_and_signals(tmp_path):
    log = read_log(scene_files.write_scene_file(tmp_path))
    assert [lane.id for lane in log.lanes] == list("1234567") and not log.has_topology
    assert log.lanes[0].lane_type == "surface_street" and log.lanes[6].lane_type == "bike_lane"
    assert log.signal_lane_ids == ("2",)
    assert log.signal_states[0, [0, 30]].tolist() == [Signal.GO, Signal.STOP]
    assert log.signal_positions.tolist() == [[0, 0, 0]]


def test_read_log_recorded_topology(tmp_path):
    lane = scene_files.lane(1, (0, 0), (9, 0), successors=[2], predecessors=[], left_neighbors=[[3, 0, 4, 1, 5]])
    log = read_log(scene_files.write_scene_file(tmp_path, scene_files.scene_content(map=[lane])))
    assert log.lanes[0].successors == ("2",) and log.lanes[0].predecessors == ()
    assert log.lanes[0].left_neighbors == (LaneNeighbor("3", 0, 4, 1, 5),)


def test_read_log_unknown_values_are_nan(tmp_path):
    scene = scene_files.scene_content()
    scene["objects"][1] |= {"z": None, "height": None}
    scene["map"][0] |= {"z": None}
    scene["sdc_index"] = None
    log = read_log(scene_files.write_scene_file(tmp_path, scene))
    assert np.isnan(log.positions[1, :, 2]).all() and np.isnan(log.sizes[1, 2]) and not np.isnan(log.sizes[1, 0])
    assert np.isnan(log.lanes[0].points[:, 2]).all() and log.ego_index == NO_EGO


def test_read_log_names_objects_without_ids(tmp_path):
    scene = scene_files.scene_content()
    for item in (*scene["objects"], *scene["map"]):
        item["id"] = None
    log = read_log(scene_files.write_scene_file(tmp_path, scene))
    assert log.object_ids[:2] == ("unnamed-0", "unnamed-1") and log.lanes[6].id == "unnamed-6"


@pytest.mark.parametrize(("speed", "agent_type"), [(0.0, AgentType.STATIC), (3.0, AgentType.CYCLIST)])
def test_read_log_moving_bicycle_is_cyclist(tmp_path, speed, agent_type):
    scene = scene_files.scene_content()
    scene["objects"].append(scene_files.moving_object((0, 0), (speed, 0), object_type="bicycle_parked_or_ridden"))
    assert read_log(scene_files.write_scene_file(tmp_path, scene)).object_types[-1] == agent_type


FAULTS = {
    "schema": (lambda s: s.update(schema="scene-json-2"), "schema"),
    "key": (lambda s: s.pop("objects"), "missing required field `objects`"),
    "object key": (lambda s: s["objects"][2].pop("vx"), "vx"),
    "lane nan": (lambda s: s["map"][1]["x"].__setitem__(3, float("nan")), "lane 2 has NaN"),
    "agent nan": (lambda s: s["objects"][1]["y"].__setitem__(4, float("nan")), "object 1 at step 4"),
    "lane absurd": (lambda s: s["map"][1]["y"].__setitem__(3, -5e9), "lane 2 has NaN or absurd"),
    "heading inf": (lambda s: s["objects"][1]["heading"].__setitem__(4, float("inf")), "headings of object 1"),
    "no lanes": (lambda s: s.update(map=s["map"][-1:]), "no lanes"),
    "empty map": (lambda s: s.update(map=[]), "no lanes"),
    "steps": (lambda s: s["objects"][0].update(x=[0.0]), "1 values for 31 timestamps"),
    "lane lengths": (lambda s: s["map"][0].update(y=[0.0]), "differ in length"),
    "no steps": (lambda s: s.update(timestamps=[]), "timestamps is empty"),
    "ego": (lambda s: s.update(sdc_index=99), "sdc_index 99"),
    "signals": (lambda s: s["tl_states"]["2"].update(state=["go"]), "1 states for 31"),
    "map type": (lambda s: s.update(map=3), "map: expected `array`"),
    "text": (lambda s: s["objects"][0].update(length="long"), r"objects\[0\].length: expected `float | null`"),
    "null in track": (lambda s: s["objects"][0]["x"].__setitem__(0, None), r"object 0 at step 0 is \[nan"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_read_log_fault_names_file_and_cause(tmp_path, fault):
    change, message = FAULTS[fault]
    scene = scene_files.scene_content()
    change(scene)
    path = scene_files.write_scene_file(tmp_path, scene)
    with pytest.raises(ValueError, match=message) as caught:
        read_log(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("size", [0, 5, 300, -3])
def test_read_log_truncated_file(tmp_path, size):
    path = scene_files.write_scene_file(tmp_path)
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(ValueError, match="not a complete gzip file") as caught:
        read_log(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("data", [b"{", b"[]", b"3", b"\xff\xfe", json.dumps({"schema": "scene-json-1"}).encode()])
def test_read_log_damaged_json(tmp_path, data):
    path = tmp_path / "bad.json.gz"
    path.write_bytes(gzip.compress(data))
    with pytest.raises(ValueError, match=r"bad\.json\.gz"):
        read_log(path)


def test_read_log_missing_file(tmp_path):
    with pytest.raises(ValueError, match="No such file"):
        read_log(tmp_path / "nowhere.json.gz")


def test_open_folder_reads_scene_files(tmp_path):
    scene_files.write_scene_file(tmp_path / "womd")
    reader = open_folder(tmp_path)
    assert isinstance(reader, LogReader) and reader.names() == ["womd/hand-made.json.gz"]
    info, log = reader.scan("womd/hand-made.json.gz"), reader.read("womd/hand-made.json.gz")
    assert (info.domain, info.cluster, info.sha256) == ("womd", "village", log.metadata.source_sha256)


def test_open_folder_without_scenes(tmp_path):
    with pytest.raises(ValueError, match=r"no \*\.json\.gz or \*\.xodr or"):
        open_folder(tmp_path)
    with pytest.raises(ValueError, match="no such folder"):
        open_folder(tmp_path / "nowhere")
