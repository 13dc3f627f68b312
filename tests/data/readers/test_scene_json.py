import gzip
import json

import numpy as np
import pytest

from scjax.data.readers.scene_json import OTHER, read_scene
from scjax.scene import AgentType, Signal
from tests.factories import raw_scenes


def test_reads_every_field(tmp_path):
    raw = read_scene(raw_scenes.write(tmp_path))
    assert (raw.domain, raw.scene_id, raw.cluster, raw.recorder) == ("womd", "hand-made", "village", 0)
    assert raw.num_steps == raw_scenes.STEPS and not raw.topology_given
    assert [lane.id for lane in raw.lanes] == list("1234567")
    assert raw.types.tolist() == [AgentType.VEHICLE] * 3 + [AgentType.PEDESTRIAN, AgentType.STATIC, OTHER]
    np.testing.assert_allclose(raw.positions[0, 10], [-10, 0, 10.8])
    np.testing.assert_allclose(raw.sizes[1], [6.0, 2.4, 2.5])
    assert raw.signal_lanes == ("2",)
    assert raw.signals[0, [0, 30]].tolist() == [Signal.GO, Signal.STOP]
    assert len(raw.sha256) == 64


def test_unknown_values_are_nan(tmp_path):
    scene = raw_scenes.content()
    scene["objects"][1] |= {"z": None, "height": None}
    scene["map"][0] |= {"z": None}
    scene["sdc_index"] = None
    raw = read_scene(raw_scenes.write(tmp_path, scene))
    assert np.isnan(raw.positions[1, :, 2]).all() and np.isnan(raw.sizes[1, 2]) and not np.isnan(raw.sizes[1, 0])
    assert np.isnan(raw.lanes[0].points[:, 2]).all() and raw.recorder == -1


@pytest.mark.parametrize(("speed", "kind"), [(0.0, AgentType.STATIC), (3.0, AgentType.CYCLIST)])
def test_a_bicycle_that_moves_is_a_cyclist(tmp_path, speed, kind):
    scene = raw_scenes.content()
    scene["objects"].append(raw_scenes.car((0, 0), (speed, 0), kind="bicycle_parked_or_ridden"))
    assert read_scene(raw_scenes.write(tmp_path, scene)).types[-1] == kind


def spoil(change):
    scene = raw_scenes.content()
    change(scene)
    return scene


FAULTS = {
    "schema": (lambda s: s.update(schema="scene-json-2"), "schema"),
    "key": (lambda s: s.pop("objects"), "missing objects"),
    "object key": (lambda s: s["objects"][2].pop("vx"), "vx"),
    "lane nan": (lambda s: s["map"][1]["x"].__setitem__(3, float("nan")), "lane 2 has NaN"),
    "agent nan": (lambda s: s["objects"][1]["y"].__setitem__(4, float("nan")), "object 1 at step 4"),
    "lane absurd": (lambda s: s["map"][1]["y"].__setitem__(3, -5e9), "lane 2 has NaN or absurd"),
    "heading inf": (lambda s: s["objects"][1]["heading"].__setitem__(4, float("inf")), "heading of object 1"),
    "no lanes": (lambda s: s.update(map=s["map"][-1:]), "no lanes"),
    "empty map": (lambda s: s.update(map=[]), "no lanes"),
    "steps": (lambda s: s["objects"][0].update(x=[0.0]), "1 values for 31 timestamps"),
    "lane lengths": (lambda s: s["map"][0].update(y=[0.0]), "differ in length"),
    "no steps": (lambda s: s.update(timestamps=[]), "timestamps is empty"),
    "recorder": (lambda s: s.update(sdc_index=99), "sdc_index 99"),
    "signals": (lambda s: s["tl_states"]["2"].update(state=["go"]), "1 states for 31"),
    "map type": (lambda s: s.update(map=3), "unexpected type"),
    "text": (lambda s: s["objects"][0].update(length="long"), "long"),
    "null in track": (lambda s: s["objects"][0]["x"].__setitem__(0, None), "object 0 at step 0 is nan"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_name_file_and_cause(tmp_path, fault):
    change, message = FAULTS[fault]
    path = raw_scenes.write(tmp_path, spoil(change))
    with pytest.raises(ValueError, match=message) as caught:
        read_scene(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("size", [0, 5, 300, -3])
def test_truncated_or_foreign_files(tmp_path, size):
    path = raw_scenes.write(tmp_path)
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(ValueError, match="not a complete gzip file") as caught:
        read_scene(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("data", [b"{", b"[]", b"3", b"\xff\xfe", json.dumps({"schema": "scene-json-1"}).encode()])
def test_damaged_json(tmp_path, data):
    path = tmp_path / "bad.json.gz"
    path.write_bytes(gzip.compress(data))
    with pytest.raises(ValueError, match=r"bad\.json\.gz"):
        read_scene(path)


def test_missing_file(tmp_path):
    with pytest.raises(ValueError, match="No such file"):
        read_scene(tmp_path / "nowhere.json.gz")
