"""Inputs that failed for users, each with its right value; the files lie in the shared folder ``cases``.

Cases without a file of their own, and those of trainings, are tests of the unit that they concern.
"""

from __future__ import annotations

import gzip
import json
import shutil
from pathlib import Path

import pytest

from scjax.cli.data import main as data_main
from scjax.data.build import load_manifest
from scjax.data.imports import import_map
from scjax.data.records import decode_record, open_records, sample_scene
from scjax.language.attributes.table import measure_attributes
from scjax.scene import Signal, validate
from scjax.scene.io import load_json, load_npz


def _assert_refused(run, *command, name: str) -> None:
    code, _, err = run(*command)
    assert code == 1 and err.count("\n") == 1 and name in err and "Traceback" not in err, err


def _files(cases_dir: Path, case: str, pattern: str) -> list[Path]:
    files = sorted((cases_dir / case).glob(pattern))
    if not files:
        pytest.skip(f"{cases_dir / case} holds no {pattern}")
    return files


def _built(cases_dir: Path, case: str, tmp_path: Path, *options: str) -> int:
    """Exit code of a strict build of the case's recording into tmp_path/out."""
    (tmp_path / "in").mkdir()
    (scene,) = _files(cases_dir, case, "scene.json")
    (tmp_path / "in" / "s.json.gz").write_bytes(gzip.compress(scene.read_bytes()))
    command = ["build", str(tmp_path / "in"), str(tmp_path / "out"), "--workers", "0", "--split-percent", "0"]
    return data_main([*command, "--strict", *options])


def _scene(tmp_path: Path):
    return sample_scene(decode_record(open_records(tmp_path / "out", "train")[0]))


@pytest.mark.parametrize(
    ("case", "pattern", "load"),
    [
        ("01-own-json-types", "*.json", load_json),
        ("03-npz-header", "*.npz", load_npz),
        ("05-absurd-values", "*.json", load_json),
    ],
)
def test_damaged_scenes_are_refused_by_name(run, cases_dir, case, pattern, load):
    for path in _files(cases_dir, case, pattern):
        with pytest.raises(ValueError, match=path.name):
            load(path)
        _assert_refused(run, "caption", path, name=path.name)


def test_damaged_model_json_is_refused_by_name(run, cases_dir, tmp_path):
    for path in _files(cases_dir, "16-model-json", "*.json"):
        folder = tmp_path / path.stem
        folder.mkdir()
        shutil.copy(path, folder / "model.json")
        _assert_refused(run, "info", "--model", folder, name=str(folder))


def test_seed_out_of_range_is_a_usage_message(run):
    for command in (("generate", "a T-intersection with several vehicles"), ("demo",)):
        code, _, err = run(*command, "--seed", 2**63)
        assert code == 2 and "--seed" in err and str(2**63 - 1) in err


def test_heading_in_degrees_is_refused(run, cases_dir):
    (path,) = _files(cases_dir, "heading-180-in-scene-file", "scene.json")
    code, _, err = run("caption", path)
    assert code == 1 and "agent 1" in err and "radians" in err


def test_cone_is_no_ego(run, cases_dir):
    (path,) = _files(cases_dir, "cone-as-ego", "scene.json")
    code, out, err = run("caption", path)
    assert code == 0 and out and "agent 0 is a static" in err


def test_lane_of_two_points_is_resampled(run, cases_dir):
    (path,) = _files(cases_dir, "lane-of-two-points", "scene.json")
    scene = validate(load_json(path))
    assert scene.lanes.shape[-2:] == (20, 3) and run("caption", path)[0] == 0


def test_source_ids_are_names(run, cases_dir):
    for path in _files(cases_dir, "source-ids-as-array-slots", "*.json"):
        scene = load_json(path)
        assert max(scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]) < 10
        assert scene.agent_mask.all() and scene.lane_mask.all() and run("caption", path)[0] == 0


def test_other_formats_are_read(run, cases_dir):
    for path in _files(cases_dir, "formats-no-reader", "one-*"):
        assert run("plot", path, "--out", f"{path.name}.png")[0] == 0
        assert import_map(path).num_lanes == (2 if path.suffix == ".xodr" else 1)


def test_joints_ten_centimeters_apart_are_reported_or_joined(cases_dir, tmp_path, capsys):
    assert _built(cases_dir, "joints-ten-centimetres-apart", tmp_path) == 0
    assert "nearly meet" in capsys.readouterr().err
    shutil.rmtree(tmp_path / "in")
    shutil.rmtree(tmp_path / "out")
    assert _built(cases_dir, "joints-ten-centimetres-apart", tmp_path, "--join-distance", "0.2") == 0
    assert len(_scene(tmp_path).lanes) == 1


def test_map_without_traffic_gives_records(cases_dir, tmp_path, capsys):
    assert _built(cases_dir, "map-without-traffic", tmp_path) == 1
    assert "--lane-poses" in capsys.readouterr().err
    shutil.rmtree(tmp_path / "in")
    assert _built(cases_dir, "map-without-traffic", tmp_path, "--lane-poses", "4") == 0
    scene = validate(_scene(tmp_path))
    assert len(scene.lanes) and not scene.agent_known[0, [3, 6, 7, 8]].any()


def test_scenes_without_a_cluster_are_places_of_their_own(cases_dir, tmp_path):
    (path,) = _files(cases_dir, "null-location-cluster", "scene.json")
    content = json.loads(path.read_text())
    (tmp_path / "in").mkdir()
    for k in range(30):
        content["scene_id"] = f"s{k}"
        (tmp_path / "in" / f"s{k}.json.gz").write_bytes(gzip.compress(json.dumps(content).encode()))
    assert data_main(["build", str(tmp_path / "in"), str(tmp_path / "out"), "--workers", "0"]) == 0
    splits = load_manifest(tmp_path / "out")["splits"]
    assert 1 <= splits["val"]["records"] <= 8 and len(splits["train"]["clusters"]) > 20


def test_null_successors_are_none(cases_dir, tmp_path):
    assert _built(cases_dir, "successors-null", tmp_path) == 0


def test_words_of_other_formats_are_understood(cases_dir, tmp_path):
    assert _built(cases_dir, "unknown-light-words", tmp_path) == 0
    scene = _scene(tmp_path)
    assert (scene.signals == Signal.STOP).any() and "red" in measure_attributes(scene)["signal"]
