"""The commands of ``scjax data`` and ``python -m scjax.data``: exit codes, messages and help."""

from __future__ import annotations

import sys

import pytest

from scjax import cli
from scjax.cli.data import main
from scjax.data import build_shards
from scjax.data.build import load_manifest
from scjax.scene.files import locked_folder
from tests.factories import scene_files
from tests.factories.words import Words


@pytest.fixture
def scenes(tmp_path):
    folder = tmp_path / "scenes"
    for number in range(3):
        scene_files.write_scene_file(folder, scene_files.scene_content(f"scene {number}", f"town {number}"))
    return folder


@pytest.fixture
def build(scenes, tmp_path):
    return ["build", str(scenes), str(tmp_path / "records"), "--workers", "0", "--files-per-shard", "2"]


def write_bad_scene(folder):
    scene_files.write_scene_file(folder, scene_files.scene_content("bad", schema="other"))


def test_build_reports_records(build, tmp_path, capsys):
    assert main(build) == 0
    assert "records of" in capsys.readouterr().out
    assert load_manifest(tmp_path / "records")["splits"]["train"]["records"] > 0


def test_build_passes_pose_options(build, tmp_path):
    assert main([*build, "--spacing", "20", "--train-max-poses", "3"]) == 0
    options = load_manifest(tmp_path / "records")["options"]
    assert options["poses"]["spacing"] == 20.0 and options["train_poses"]["max_poses"] == 3
    assert options["poses"]["max_poses"] == 8 and options["train_poses"]["spacing"] == 4.0


def test_build_with_skipped_files_exits_3(build, scenes, capsys):
    write_bad_scene(scenes)
    assert main(build) == 3
    assert "skipped bad.json.gz" in capsys.readouterr().err


def test_build_strict_exits_1_at_bad_file(build, scenes, capsys):
    write_bad_scene(scenes)
    assert main([*build, "--strict"]) == 1
    assert "--strict stops" in capsys.readouterr().err


@pytest.mark.parametrize(
    "option",
    [
        ("--limit", "0"),
        ("--workers", "-1"),
        ("--workers", "100000"),
        ("--files-per-shard", "0"),
        ("--files-per-shard", "99999999999999999999"),
        ("--split-percent", "nan"),
        ("--split-percent", "100"),
        ("--spacing", "0"),
        ("--spacing", "nan"),
        ("--train-spacing", "inf"),
        ("--max-poses", "0"),
        ("--train-recorder-stride", "-3"),
        ("--other-stride", "99999999999999999999"),
    ],
)
def test_build_bad_value_exits_1(build, option, tmp_path, capsys):
    assert main([*build, *option]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert option[0].strip("-") in error.replace("_", "-")
    assert not (tmp_path / "records").exists()


@pytest.mark.parametrize(
    "option",
    [
        ("--worlds", "0"),
        ("--worlds", "99999999999999"),
        ("--seed", "-1"),
        ("--seed", str(2**63)),
        ("--ordinary", "nan"),
        ("--split-percent", "-inf"),
        ("--workers", "-1"),
    ],
)
def test_synthetic_bad_value_exits_1(option, tmp_path, capsys):
    assert main(["synthetic", str(tmp_path / "records"), "--workers", "0", *option]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert not (tmp_path / "records").exists()


@pytest.mark.parametrize("command", ["build", "synthetic", "caption", "embed"])
def test_second_process_is_refused(command, build, tmp_path, monkeypatch, capsys):
    records = tmp_path / "records"
    assert main(build) == 0 and main(["caption", str(records), "--workers", "0"]) == 0
    monkeypatch.setattr("scjax.encoders.text.load_text_encoder", lambda folder: Words())
    words = {"build": build, "synthetic": ["synthetic", str(records), "--worlds", "1"]}
    capsys.readouterr()
    with locked_folder(records):
        assert main(words.get(command, [command, str(records)])) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and "in use by another process" in error and error.count("\n") == 1


def test_embed_again_says_that_nothing_is_to_do(build, tmp_path, monkeypatch, capsys):
    """Captions are written again with the same options: the same bytes, whose features stay."""
    monkeypatch.setattr("scjax.encoders.text.load_text_encoder", lambda folder: Words())
    records = str(tmp_path / "records")
    for command in (build, ["caption", records, "--workers", "0"], ["embed", records]):
        assert main(command) == 0
    assert "different texts embedded" in capsys.readouterr().out
    before = (tmp_path / "records" / "text-train.bin").stat().st_mtime_ns
    assert main(["caption", records, "--workers", "0"]) == 0 and main(["embed", records]) == 0
    assert "nothing to do" in capsys.readouterr().out
    assert (tmp_path / "records" / "text-train.bin").stat().st_mtime_ns == before


def test_fault_of_the_program_is_one_line(build, monkeypatch, capsys):
    def fail(*_):
        raise TypeError("an integer\nis required")

    monkeypatch.setattr(build_shards, "write_shard", fail)
    assert main(build) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: TypeError: an integer is required: please report") and error.count("\n") == 1


def test_build_without_scenes_exits_1(tmp_path, capsys):
    records = str(tmp_path / "records")
    assert main(["build", str(tmp_path / "nowhere"), records]) == 1
    (tmp_path / "empty").mkdir()
    assert main(["build", str(tmp_path / "empty"), records]) == 1
    assert capsys.readouterr().err.count("error: ") == 2


def test_build_into_a_file_exits_1(scenes, tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("x")
    assert main(["build", str(scenes), str(file)]) == 1
    assert "is not a folder" in capsys.readouterr().err


def test_build_with_only_bad_files_exits_1(tmp_path, capsys):
    write_bad_scene(tmp_path / "scenes")
    assert main(["build", str(tmp_path / "scenes"), str(tmp_path / "out"), "--workers", "0"]) == 1
    assert "none of 1 files can be used" in capsys.readouterr().err


@pytest.mark.parametrize("wrong", [[], ["build"], ["fly"], ["build", "a", "b", "--workers", "two"]])
def test_wrong_usage_exits_2(wrong):
    assert main(wrong) == 2


def test_interrupted_build_exits_130(build, monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(build_shards, "write_shard", interrupt)
    assert main(build) == 130
    assert "run the same command again" in capsys.readouterr().err


def test_build_help_names_options_and_defaults(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "130")
    assert main(["build", "--help"]) == 0
    text = capsys.readouterr().out
    for word in ("--workers", "--train-spacing", "--split-percent", "default: 16.0"):
        assert word in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 130


def test_help_names_commands_and_exit_codes(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for word in ("Exit codes", "build", "synthetic", "caption", "embed", "scenes"):
        assert word in text


def test_synthetic_takes_several_events(tmp_path, capsys):
    assert main(["synthetic", str(tmp_path), "--worlds", "1", "--workers", "0", "--events", "double-parking", "x"]) == 1
    assert "unknown event 'x'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (("--texts", "0"), "at least one text"),
        (("--texts", "99999999"), "1000 at most"),
        (("--seed", "-1"), "a whole number from 0"),
        (("--seed", str(2**63)), "a whole number from 0"),
        (("--workers", "-1"), "0 or more processes"),
        ((), "manifest.json: not there"),
    ],
)
def test_caption_bad_value_exits_1(tmp_path, option, message, capsys):
    assert main(["caption", str(tmp_path), *option]) == 1
    assert message in capsys.readouterr().err


def test_embed_without_captions_exits_1(tmp_path, capsys):
    assert main(["embed", str(tmp_path), "--encoder", str(tmp_path / "nowhere")]) == 1
    assert "error: " in capsys.readouterr().err


@pytest.mark.parametrize(("bad", "code"), [(False, 0), (True, 3)])
def test_scjax_data_exits_with_the_same_code(build, scenes, bad, code, monkeypatch, capsys):
    if bad:
        write_bad_scene(scenes)
    monkeypatch.setattr(sys, "argv", ["scjax", "data", *build])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == code
    assert "records of" in capsys.readouterr().out
