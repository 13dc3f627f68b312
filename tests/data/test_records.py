import dataclasses
import json

import numpy as np
import pytest

from scjax.data import records
from scjax.data.agents import clean_agents
from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.local_map import LocalMap, simplify_graph
from scjax.data.readers.scene_json import read_log
from scjax.data.tiles import find_poses
from scjax.scene import AgentType, Crop, Link, Signal, validate
from tests.factories import scene_files


def make(tmp_path, scene=None, pose=0):
    log = read_log(scene_files.write_scene_file(tmp_path, scene))
    graph = build_graph(log)
    index = index_segments(graph)
    return records.make_record(log, simplify_graph(graph), index, find_poses(log, index)[pose], 0)


def test_encode_record_round_trip(tmp_path):
    record, _ = make(tmp_path)
    decoded = records.decode_record(records.encode_record(record))
    for field in dataclasses.fields(LocalMap):
        expected, actual = getattr(record.local_map, field.name), getattr(decoded.local_map, field.name)
        np.testing.assert_array_equal(actual, expected, err_msg=field.name)
    assert dataclasses.replace(decoded, local_map=record.local_map) == record
    assert (record.cluster, record.scene_id, record.step, record.object_index, record.is_recorder) == (
        "village",
        "hand-made",
        0,
        0,
        True,
    )


def test_encode_record_keeps_stored_names(tmp_path):
    """Names on disk are those of format 1, whatever the fields are called today."""
    data = records.encode_record(make(tmp_path)[0])
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    origin = json.loads(header.pop("__metadata__")["record"])
    assert set(origin) == {"format", "domain", "cluster", "scene_id", "step", "object", "is_recorder"}
    assert set(header) == {
        *("points", "offsets", "lane_z_known", "edges", "beside", "spans", "signals"),
        *("agents", "agent_types", "agent_known", "off_road"),
    }


def test_make_record_holds_80_m(tmp_path):
    record, _ = make(tmp_path)
    assert np.abs(record.local_map.points[:, :2]).max() == pytest.approx(80.0)
    assert len(record.local_map.points) < 20  # straight lanes need two points


@pytest.mark.parametrize("crop", list(Crop))
def test_sample_scene_of_every_crop(tmp_path, crop):
    record, _ = make(tmp_path, pose=1)
    scene = validate(records.sample_scene(record, crop))
    assert scene.crop == crop and scene.domain == 0
    assert (scene.links == Link.LEFT).any() and (scene.signals == Signal.STOP).any()
    assert set(scene.agent_types.tolist()) >= {AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.STATIC}
    np.testing.assert_allclose(scene.agents[0], [0, 0, 0.8, 10, 1, 0, 4.5, 2, 1.6], atol=1e-6)
    parked = records.sample_scene(record, crop, off_road=True)
    assert len(parked.agents) == len(scene.agents) + (crop != Crop.FORWARD)


def test_sample_scene_ego_stays_agent_0(tmp_path):
    record, _ = make(tmp_path)
    for dx in (-2.0, 2.0):
        scene = validate(records.sample_scene(record, Crop.FORWARD, dx, 0.5, 0.1))
        np.testing.assert_allclose(np.hypot(*scene.agents[0, :2]), np.hypot(dx, 0.5), rtol=1e-5)
        assert scene.agents[0, 3] == 10


def test_sample_scene_refuses_large_offsets(tmp_path):
    record, _ = make(tmp_path)
    records.sample_scene(record, Crop.FORWARD, 8.0)
    with pytest.raises(ValueError, match=r"FORWARD window then reaches 80\.6 m"):
        records.sample_scene(record, Crop.FORWARD, 9.0)
    records.sample_scene(record, Crop.CENTERED, 30.0, -10.0)


def test_make_record_fills_unknown_values(tmp_path):
    scene = scene_files.scene_content()
    scene["objects"][1] |= {"length": 0.0, "height": None, "z": None, "vx": [60.0] * scene_files.STEPS}
    record, counts = make(tmp_path, scene)
    assert counts == {"size": 1, "speed": 1}
    row = int(np.flatnonzero(record.local_map.agents[:, 3] == 35.0)[0])
    np.testing.assert_allclose(record.local_map.agents[row, [2, 6, 7, 8]], [0.0, 4.87, 2.4, 1.80], rtol=1e-6)
    assert record.local_map.agent_known[row].tolist() == [True, True, False, True, True, True, False, True, False]


def test_clean_agents_keeps_good_values():
    states = np.array([[1, 2, 0.9, 34.9, 1, 0, 4.5, 2, 1.6]])
    out, known, counts = clean_agents(states, np.array([AgentType.VEHICLE]))
    np.testing.assert_array_equal(out, states)
    assert known.all() and not any(counts.values())


@pytest.mark.parametrize(
    "damage",
    [
        lambda b: b"",
        lambda b: b[:40],
        lambda b: b[:-9],
        lambda b: bytes(100),
        lambda b: b.replace(b'\\"step\\"', b'\\"stop\\"'),
    ],
)
def test_decode_record_damaged_bytes(tmp_path, damage):
    data = records.encode_record(make(tmp_path)[0])
    with pytest.raises(ValueError, match="no scene record"):
        records.decode_record(damage(data))


def test_decode_record_other_format(tmp_path):
    data = records.encode_record(make(tmp_path)[0]).replace(b'\\"format\\": 1', b'\\"format\\": 7')
    with pytest.raises(ValueError, match="record format 7, not 1"):
        records.decode_record(data)


def test_write_shard_and_open_records(tmp_path):
    data = records.encode_record(make(tmp_path)[0])
    for number in range(2):
        count = records.write_shard(tmp_path / f"val-0000{number}-of-00002.arrayrecord", [data] * (3 + number))
        assert count == 3 + number
    stored = records.open_records(tmp_path, "val")
    assert len(stored) == 7 and list(stored) == [data] * 7 and stored[6] == data
    assert not list(tmp_path.glob("*.part")) + list(tmp_path.glob(".*.part"))


def test_open_records_refuses_incomplete_sets(tmp_path):
    records.write_shard(tmp_path / "val-00000-of-00002.arrayrecord", [b"record"])
    with pytest.raises(ValueError, match="not the complete set of 2"):
        records.open_records(tmp_path, "val")
    with pytest.raises(ValueError, match="no train shards"):
        records.open_records(tmp_path, "train")


def test_write_shard_failure_leaves_nothing(tmp_path):
    def broken():
        yield b"one"
        raise RuntimeError("disk on fire")

    with pytest.raises(RuntimeError, match="disk on fire"):
        records.write_shard(tmp_path / "train-00000-of-00001.arrayrecord", broken())
    assert list(tmp_path.iterdir()) == []
