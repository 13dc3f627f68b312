"""Exports say in one line what is wrong, and write nothing."""

from __future__ import annotations

import dataclasses
import re

import click
import numpy as np
import pytest

from scjax.export import EXPORTS, export_log
from scjax.scene import NO_EGO, AgentType, map_to_log, save_log, save_map
from tests.factories.exports import crossing_log
from tests.factories.maps import two_tile_map

NATIVE = ("npz", "json", "scenarionet", "waymax", "gpudrive", "commonroad", "opendrive", "openscenario")
OTHERS = ("lanelet2", "sumo", "womd", "clipgt", "rdshq")


def _path(format, folder):
    return folder / f"file{EXPORTS[format].suffix}"


def test_unknown_format_names_those_there_are(tmp_path):
    with pytest.raises(ValueError, match="format is 'lanelet': choose from npz, json, scenarionet"):
        export_log(crossing_log(), tmp_path / "x", "lanelet")


@pytest.mark.parametrize("format", NATIVE[2:])
def test_log_without_lanes_is_refused(format, tmp_path):
    log = dataclasses.replace(crossing_log(), lanes=())
    with pytest.raises(ValueError, match="no lane with a length"):
        export_log(log, _path(format, tmp_path), format)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("format", ["scenarionet", "waymax", "gpudrive"])
def test_log_without_a_vehicle_is_refused(format, tmp_path):
    log = crossing_log(object_types=np.array([AgentType.PEDESTRIAN] * 2), ego_index=NO_EGO)
    with pytest.raises(ValueError, match=r"no vehicle: .* needs a car to control"):
        export_log(log, _path(format, tmp_path), format)


@pytest.mark.parametrize("format", NATIVE)
def test_log_of_one_step_is_written(format, tmp_path):
    report = export_log(map_to_log(two_tile_map()), _path(format, tmp_path), format)
    assert all(path.stat().st_size for path in report.paths)


@pytest.mark.parametrize("format", ["commonroad", "opendrive", "openscenario", "json"])
def test_log_without_objects_is_written(format, tmp_path):
    log = crossing_log()[:3]
    names = ("object_types", "valid", "positions", "headings", "velocities", "sizes")
    empty = dataclasses.replace(
        log, object_ids=(), ego_index=NO_EGO, **{name: getattr(log, name)[:0] for name in names}
    )
    assert export_log(empty, _path(format, tmp_path), format).paths[0].is_file()


@pytest.mark.parametrize("format", NATIVE)
def test_path_that_cannot_be_written_is_named(format, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises((OSError, ValueError), match="file"):
        export_log(crossing_log(), tmp_path / "file" / "x", format)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_invalid_log_is_refused(tmp_path):
    with pytest.raises(ValueError, match="timestamps must be finite"):
        export_log(crossing_log(timestamps=np.zeros(20)), tmp_path / "x.xodr", "opendrive")


def test_folder_of_other_pickles_is_refused(tmp_path):
    (tmp_path / "dataset_summary.pkl").write_bytes(b"no pickle")
    with pytest.raises(ValueError, match=r"dataset_summary\.pkl"):
        export_log(crossing_log(), tmp_path, "scenarionet")


@pytest.mark.parametrize("format", OTHERS)
def test_missing_roadgen_is_named_with_the_command(format, monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install roadgen==0\.41\.2"):
        export_log(crossing_log(), tmp_path / "x", format)


def test_export_command_writes_files_and_says_what_is_lost(run, tmp_path):
    save_map(two_tile_map(), tmp_path / "map.json")
    code, out, err = run("export", "map.json", "--to", "opendrive")
    assert code == 0 and out.split() == ["map.xodr"] and (tmp_path / "map.xodr").is_file()
    assert "     1  objects, left out" in err.splitlines()


def test_export_command_never_overwrites_its_input(run, tmp_path):
    save_log(crossing_log(), tmp_path / "log.npz")
    before = (tmp_path / "log.npz").read_bytes()
    assert run("export", "log.npz", "--to", "waymax")[1].split() == ["log-waymax.npz"]
    assert run("export", "log.npz", "--to", "npz")[1].split() == ["log-npz.npz"]
    assert (tmp_path / "log.npz").read_bytes() == before


def test_export_command_prints_json(run, tmp_path):
    import json

    save_log(crossing_log(), tmp_path / "log.npz")
    content = json.loads(run("export", "log.npz", "--to", "commonroad", "--json")[1])
    assert content["files"] == ["log.xml"] and content["losses"]["heights of lanes, left out"] == 8


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["log.npz", "--to", "lanelet"], 2, "--to is 'lanelet': choose from npz"),
        (["log.npz"], 2, "Missing option '--to'"),
        (["log.npz", "--to", "npz", "--scene", "1"], 2, "--scene is for files of scenes"),
        (["absent.npz", "--to", "npz"], 1, "absent.npz: there is no such file"),
        (["map.json", "--to", "gpudrive", "--out", "map.json/x.json"], 1, "map.json cannot be written to"),
    ],
)
def test_export_command_says_what_is_wrong(arguments, code, message, run, tmp_path):
    save_map(two_tile_map(), tmp_path / "map.json")
    save_log(crossing_log(), tmp_path / "log.npz")
    actual, _, err = run("export", *arguments)
    assert (actual, message in err) == (code, True), err


def test_help_of_the_command_names_every_format():
    from scjax.cli.export import export_command

    text = export_command.get_help(click.Context(export_command))
    assert set(EXPORTS) <= set(re.findall(r"^ +(\w+) ", text, re.MULTILINE))
