"""Scenes in files: exact .npz, readable JSON, and complaints that name the file."""

from __future__ import annotations

import json
import re

import jax
import numpy as np
import pytest

from scjax.scene import Crop, Link, Scene, empty, validate
from scjax.scene import io as scene_io
from tests.factories.examples import example_batch, example_scene

SCENES = {
    "single": example_scene,
    "batch": lambda: example_batch(3),
    "grid": lambda: jax.tree.map(lambda leaf: leaf.reshape(2, 2, *leaf.shape[1:]), example_batch(4)),
    "forward": lambda: example_scene(crop=Crop.FORWARD),
    "nothing": lambda: empty(0, 0),
    "no scenes": lambda: example_batch(2)[:0],
    "jax": lambda: jax.tree.map(jax.numpy.asarray, example_scene()),
}


def _assert_same(actual: Scene, expected: Scene, tolerance: float = 0.0):
    assert actual.batch_shape == expected.batch_shape
    for name, value in expected.to_numpy().to_dict().items():
        array = getattr(actual, name)
        assert isinstance(array, np.ndarray) and array.dtype == value.dtype and array.shape == value.shape, name
        np.testing.assert_allclose(array, value, rtol=tolerance, atol=tolerance, err_msg=name)


@pytest.mark.parametrize("name", SCENES)
def test_save_npz_round_trip_is_exact(name, tmp_path):
    scene = SCENES[name]()
    scene_io.save_npz(scene, tmp_path / "new" / "scene.npz")
    _assert_same(scene_io.load_npz(tmp_path / "new" / "scene.npz"), scene)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["scene.npz"]


@pytest.mark.parametrize("name", SCENES)
def test_save_json_round_trip(name, tmp_path):
    scene = SCENES[name]()
    scene_io.save_json(scene, tmp_path / "scene.json")
    _assert_same(scene_io.load_json(tmp_path / "scene.json"), scene, 1e-6)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.json"]


def test_scene_to_json_is_readable():
    scene = example_scene(agents=2, lanes=3)
    data = json.loads(scene_io.scene_to_json(scene))
    assert data["units"]["speed"] == "m/s" and data["version"] == 1
    ego, other = data["scenes"][0]["agents"]
    assert ego["heading"] == pytest.approx(np.arctan2(scene.agents[0, 5], scene.agents[0, 4]), abs=1e-6)
    assert ego["type"] in ("vehicle", "pedestrian", "cyclist", "static")
    assert ego["unknown"] == [] and other["unknown"] == ["z"]
    first, second, third = data["scenes"][0]["lanes"]
    assert first["successors"] == [1] and second["successors"] == []
    assert second["right"] == [2] and third["left"] == [1] and second["left"] == []
    assert len(first["points"]) == 20 and first["unknown"] == ["z"]


def test_json_keeps_empty_slots():
    scene = example_scene(lanes=3)
    scene.agent_mask[1] = False
    scene.agents[1], scene.agent_known[1], scene.agent_types[1] = 0, False, 0
    _assert_same(scene_io.scene_from_json(scene_io.scene_to_json(scene)), scene, 1e-6)


def test_json_keeps_ring_of_two_lanes():
    scene = empty(0, 2)
    scene.lane_mask[:], scene.lane_known[:] = True, True
    scene.links[:] = [[Link.SELF, Link.PREDECESSOR], [Link.PREDECESSOR, Link.SELF]]
    _assert_same(scene_io.scene_from_json(scene_io.scene_to_json(scene)), scene)


def _by_hand() -> dict:
    agent = {
        "id": 0,
        "type": "vehicle",
        "x": 0,
        "y": 0,
        "z": 0.8,
        "speed": 5,
        "heading": 0.0,
        "length": 4.5,
        "width": 2,
        "height": 1.6,
    }
    lanes = [{"id": i, "points": [[k, 3.5 * i, 0] for k in range(20)]} for i in range(2)]
    return {"format": "scjax-scene", "version": 1, "scenes": [{"agents": [agent], "lanes": lanes}]}


def test_scene_from_json_defaults():
    data = _by_hand()
    data["scenes"][0]["lanes"][0]["left"] = [1]
    scene = validate(scene_io.scene_from_json(json.dumps(data)))[0]
    assert scene.links[1, 0] == Link.LEFT and scene.links[0, 1] == Link.RIGHT
    assert scene.agents[0].tolist() == pytest.approx([0, 0, 0.8, 5, 1, 0, 4.5, 2, 1.6])
    assert scene.agent_known.all() and scene.crop == Crop.CENTERED


def _without(key):
    return lambda d: d["scenes"][0]["agents"][0].pop(key)


def _lane(**changes):
    return lambda d: d["scenes"][0]["lanes"][0].update(changes)


def _agent(**changes):
    return lambda d: d["scenes"][0]["agents"][0].update(changes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format="other"), 'must be an object with "format"'),
        (lambda d: d.update(version=9), "format version 9, this scjax reads 1"),
        (lambda d: d.pop("version"), "no format version"),
        (lambda d: d.pop("scenes"), "missing required field `scenes`"),
        (lambda d: d.update(batch_shape=[3]), r"batch_shape \[3\] does not fit 1 scenes"),
        (lambda d: d["scenes"][0].pop("lanes"), r"scenes\[0\]: object missing required field `lanes`"),
        (_without("speed"), r"scenes\[0\].agents\[0\]: object missing required field `speed`"),
        (_without("id"), "missing required field `id`"),
        (_agent(id=-1), r"agents\[0\].id: expected `int` >= 0"),
        (_agent(x="left"), r"agents\[0\].x: expected `float`, got `str`"),
        (_agent(type="tram"), r"agents\[0\].type: invalid enum value 'tram'"),
        (_agent(length=0), r"agents\[0\].length: expected `float` > 0"),
        (_agent(unknown=["mass"]), r"unknown\[0\]: invalid enum value 'mass'"),
        (_lane(points=[[0, 0, 0]]), r"lanes\[0\].points: expected `array` of length >= 2"),
        (_lane(points=[[0, 0], [1, 2, 3]]), "lane 0: some points have z and some have not"),
        (_lane(signal="blue"), r"lanes\[0\].signal: invalid enum value 'blue'"),
        (_lane(successors=[7]), "successors names 7"),
        (_lane(successors=[0]), "successors names 0"),
        (_lane(successors=[1], left=[1]), "left names 1, which is linked to it in another way"),
        (_lane(id=1), "lanes: the id 1 is used twice"),
    ],
)
def test_load_json_fault_names_file_and_place(change, message, tmp_path):
    data = _by_hand()
    change(data)
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(data))
    with pytest.raises(ValueError, match=re.escape(str(path)) + ".*" + message):
        scene_io.load_json(path)


def test_load_json_truncated_file(tmp_path):
    path = tmp_path / "short.json"
    path.write_text(scene_io.scene_to_json(example_scene())[:500])
    with pytest.raises(ValueError, match=r"short.json is no JSON"):
        scene_io.load_json(path)


@pytest.mark.parametrize("size", [0, 10, 400, -30])
def test_load_npz_truncated_file(size, tmp_path):
    path = tmp_path / "short.npz"
    scene_io.save_npz(example_scene(), path)
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(ValueError, match=r"short.npz is no readable .npz file"):
        scene_io.load_npz(path)


def _arrays() -> dict:
    return {"format_version": np.int64(1), **example_scene().to_dict()}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format_version=2), "format version 2, this scjax reads 1"),
        (lambda d: d.pop("format_version"), "no format version"),
        (lambda d: d.pop("links"), r"lacks the arrays \['links'\]"),
        (lambda d: d.pop("crop"), "lacks the array 'layout'"),
        (lambda d: d.update(signals=d["signals"] * 1.5), "signals has the type float64"),
        (lambda d: d.update(signals=d["signals"][:3]), "invalid scene: signals has shape"),
        (lambda d: d.update(agents=np.array([{}], object)), "no readable .npz file"),
    ],
)
def test_load_npz_fault_names_file(change, message, tmp_path):
    arrays, path = _arrays(), tmp_path / "mine.npz"
    change(arrays)
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=f"mine.npz.*{message}"):
        scene_io.load_npz(path)


def test_save_refuses_invalid_scenes(tmp_path):
    scene = example_scene()
    scene.agents[0, 0] = np.nan
    for save in (scene_io.save_npz, scene_io.save_json):
        with pytest.raises(ValueError, match="NaN"):
            save(scene, tmp_path / "bad")
    assert not list(tmp_path.iterdir())


def test_load_missing_file(tmp_path):
    for load in (scene_io.load_npz, scene_io.load_json):
        with pytest.raises(FileNotFoundError):
            load(tmp_path / "nowhere")


def test_npz_files_name_the_crop_layout(tmp_path):
    """Files keep the names of their first version, which other programs read."""
    scene_io.save_npz(example_scene(crop=Crop.FORWARD), tmp_path / "scene.npz")
    with np.load(tmp_path / "scene.npz") as file:
        assert int(file["layout"]) == Crop.FORWARD and "crop" not in file


@pytest.mark.parametrize("crop_name", ["layout", "crop"])
def test_load_npz_reads_both_names_of_the_crop(crop_name, tmp_path):
    scene = example_scene(crop=Crop.FORWARD)
    arrays = {"format_version": np.int64(1), **scene.to_dict()}
    arrays[crop_name] = arrays.pop("crop")
    np.savez(tmp_path / "old.npz", **arrays)
    _assert_same(scene_io.load_npz(tmp_path / "old.npz"), scene)


def test_json_files_name_the_crop_layout():
    scene = json.loads(scene_io.scene_to_json(example_scene(crop=Crop.CENTERED)))["scenes"][0]
    assert scene["layout"] == "centred" and "crop" not in scene


@pytest.mark.parametrize(
    ("field", "word", "crop"),
    [
        ("layout", "centred", Crop.CENTERED),
        ("layout", "partitioned", Crop.PARTITIONED),
        ("layout", "forward", Crop.FORWARD),
        ("crop", "centered", Crop.CENTERED),
        ("crop", "forward", Crop.FORWARD),
    ],
)
def test_scene_from_json_reads_both_names_of_the_crop(field, word, crop):
    data = _by_hand()
    data["scenes"][0][field] = word
    assert int(scene_io.scene_from_json(json.dumps(data))[0].crop) == crop
