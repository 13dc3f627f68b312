"""ScenarioNet pickles: what they hold, and that nothing in them runs."""

from __future__ import annotations

import collections
import os
import pickle
import pickletools

import numpy as np
import pytest

from scjax.data.readers.restricted_pickle import load_plain_pickle
from scjax.data.readers.scenarionet import read_scenarionet
from scjax.scene import AgentType, Signal
from tests.factories.map_files import scenarionet


def _read(tmp_path, content, protocol: int = 4):
    path = tmp_path / "sd_scene.pkl"
    path.write_bytes(content if isinstance(content, bytes) else pickle.dumps(content, protocol))
    return read_scenarionet(path)


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_read_scenarionet_reads_tracks_lights_and_lanes(protocol, tmp_path):
    log = _read(tmp_path, scenarionet(), protocol)
    assert log.metadata.domain == "waymo" and log.ego_index == 0 and log.has_topology
    assert log.object_types.tolist() == [AgentType.VEHICLE, AgentType.STATIC]
    assert log.valid[1].tolist() == [False, True, True, True] and not log.positions[1, 0].any()
    np.testing.assert_allclose(log.sizes, [[4.5, 2.0, 1.6]] * 2)
    assert [lane.id for lane in log.lanes] == ["a", "b"] and log.lanes[0].successors == ("b",)
    assert log.signal_states.tolist() == [[Signal.STOP] * 3 + [Signal.GO]]
    assert log.metadata.notes == {"map features CROSSWALK, not read": 1}


def test_elevation_of_nuscenes_lanes_is_not_known(tmp_path):
    content = scenarionet()
    content["metadata"]["dataset"] = "nuscenes"  # the third column of its lanes is their direction
    assert np.isnan(_read(tmp_path, content).lanes[0].points[:, 2]).all()


def test_plain_pickles_hold_numbers_texts_and_containers():
    table = collections.defaultdict(int, {"a": 1})
    value = [np.arange(3), np.float32(2.5), {"x", "y"}, (1, None), table, np.array(["go", "stop"]), b"raw"]
    array, number, words, pair, plain, texts, raw = load_plain_pickle(pickle.dumps(value))
    assert array.tolist() == [0, 1, 2] and number == 2.5 and words == {"x", "y"} and pair == (1, None)
    assert plain == {"a": 1} and type(plain) is dict and texts.tolist() == ["go", "stop"] and raw == b"raw"


def test_number_types_of_a_pickle_stay_its_own():
    swapped = load_plain_pickle(pickle.dumps(np.arange(3, dtype=">f8")))
    assert swapped.tolist() == [0, 1, 2] and np.dtype("f8").isnative and swapped.flags.owndata
    assert load_plain_pickle(pickle.dumps(np.asfortranarray(np.eye(3)[:2]), 5)).tolist() == np.eye(3)[:2].tolist()


class _Calls:
    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def _nested(depth: int) -> bytes:
    return pickle.PROTO + b"\x04" + b"K\x01" + depth * b"\x85" + b"."


HOSTILE = {
    "system": pickle.dumps(_Calls(os.system, "touch hacked")),
    "eval": pickle.dumps(_Calls(eval, "1 + 1")),
    "getattr": pickle.dumps(_Calls(getattr, "text", "upper")),
    "object array": pickle.dumps(np.array([None, {}], dtype=object)),
    "memory": pickle.dumps(_Calls(np.ndarray, (1 << 40,))),
    "bytes": pickle.dumps(_Calls(bytearray, 1 << 40)),
    "empty array": b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(J\xff\xff\xff\x7ftU\x01btR.",
    "number type": b"\x80\x02cnumpy\ndtype\n(X\x02\x00\x00\x00f8K\x00K\x01tR"
    b"(K\x03X\x01\x00\x00\x00<N(X\x01\x00\x00\x00atNtb.",
    "changed function": b"\x80\x02ccollections\nOrderedDict\n(N}X\x0c\x00\x00\x00__defaults__K\x01stb.",
    "structured array": pickle.dumps(np.zeros(2, [("a", "f8"), ("b", "O")])),
    "bytes of another size": pickle.dumps(np.zeros(4)).replace(b"K\x04\x85", b"K\x05\x85"),
    "nested": _nested(200_000),
    "reference": b"\x80\x04Ppersistent\n.",
    "mark": b"\x80\x04((((.",
    "cut": pickle.dumps(scenarionet())[:900],
    "nothing": b"",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_pickles_are_refused_and_nothing_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"sd_scene\.pkl: ") as error:
        _read(tmp_path, HOSTILE[name])
    assert "\n" not in str(error.value) and len(str(error.value)) < 400
    assert [path.name for path in tmp_path.iterdir()] == ["sd_scene.pkl"]


def test_nesting_is_followed_through_the_memo():
    step = pickletools.optimize(pickle.dumps((1,)))[-3:-1]
    assert b"\x85" in step
    with pytest.raises(ValueError, match="nested more than 64 deep"):
        load_plain_pickle(b"\x80\x04K\x01\x94" + 40 * b"\x85\x94" + b"0" + b"h\x28" + 40 * b"\x85" + b".")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tracks": []}, "tracks is list, not a dict"),
        ({"map_features": {}}, "map_features holds no lanes"),
        ({"length": 0}, "length is 0"),
        ({"length": 10**12}, "length is 1000000000000"),
        ({"length": 3}, r"metadata.ts has the shape|tracks\[7\].state"),
        ({"tracks": {"7": {"type": "VEHICLE"}}}, r"tracks\[7\].state is NoneType, not a dict"),
        ({"map_features": {"a": {"type": "LANE_SURFACE_STREET"}}}, r"map_features\[a\].polyline"),
        ({"map_features": {"a": {"type": "LANE_SURFACE_STREET", "polyline": ["x"]}}}, "no list of numbers or points"),
        ({"dynamic_map_states": {"b": {"state": {"object_state": []}}}}, "has not one word for each step"),
    ],
)
def test_scenarios_with_faults_name_the_field(changes, message, tmp_path):
    with pytest.raises(ValueError, match=message) as error:
        _read(tmp_path, scenarionet(**changes))
    assert str(error.value).startswith(str(tmp_path / "sd_scene.pkl"))
