"""``scjax data scenes``: scenes of records as files."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.cli.data import main
from scjax.cli.data.scenes import choose_numbers
from scjax.cli.output import slug
from scjax.data.build import load_manifest
from scjax.data.records import decode_record, open_records, read_record, sample_scene
from scjax.scene.io import load_json, load_npz


@pytest.fixture(scope="module")
def records(world_records):
    return world_records


@pytest.fixture
def scenes(records, tmp_path, capsys):
    """Runs the command: (exit code, stdout, stderr)."""

    def run(*options, source=records, out=tmp_path / "out"):
        code = main(["scenes", str(source), "--out", str(out), *map(str, options)])
        return code, *capsys.readouterr()

    return run


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def assert_equal(one, other):
    for name, value in one.to_dict().items():
        np.testing.assert_array_equal(value, getattr(other, name), err_msg=name)


@pytest.mark.parametrize(("total", "count"), [(1, 1), (7, 7), (10, 3), (1000, 999), (10**6, 17)])
def test_choose_numbers_takes_equal_distances(total, count):
    numbers = choose_numbers(total, count, None)
    assert numbers == sorted(set(numbers)) and len(numbers) == count
    middles = (np.arange(count) + 0.5) * total / count  # of equal parts
    assert (np.abs(np.array(numbers) - middles) <= 1).all()


@pytest.mark.parametrize("seed", [0, 1, 2**63 - 1])
def test_choose_numbers_depends_on_the_seed(seed):
    numbers = choose_numbers(1000, 20, seed)
    assert numbers == sorted(set(numbers)) and len(numbers) == 20 and 0 <= numbers[0] and numbers[-1] < 1000
    assert numbers == choose_numbers(1000, 20, seed) != choose_numbers(1000, 20, 5)


def test_scenes_are_those_of_the_records(scenes, records, tmp_path):
    """All records of both splits, each in the file that names its world, split and number."""
    sizes = {name: entry["records"] for name, entry in load_manifest(records)["splits"].items()}
    for ending in ("npz", "json"):
        assert scenes("-n", sum(sizes.values()), "--format", ending)[0] == 0
    paths = {path.name for path in (tmp_path / "out").iterdir()}
    for split, size in sizes.items():
        stored = open_records(records, split)
        for row in range(size):
            record = read_record(stored, row)
            name = f"{slug(record.scene_id)}-{split}-{row:06d}"
            paths -= {f"{name}.npz", f"{name}.json"}
            assert_equal(load_npz(tmp_path / "out" / f"{name}.npz"), sample_scene(record))
            np.testing.assert_allclose(
                load_json(tmp_path / "out" / f"{name}.json").lanes, sample_scene(record).lanes, atol=0.01
            )
    assert not paths


@pytest.mark.parametrize("split", ["train", "val"])
def test_scenes_of_one_split(scenes, tmp_path, split):
    code, out, _ = scenes("-n", 2, "--split", split, "--format", "png")
    assert (code, out) == (0, f"{tmp_path / 'out'}: 2 scenes of {split}\n")
    assert len(names(tmp_path / "out")) == 2 and all(f"-{split}-" in name for name in names(tmp_path / "out"))
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in (tmp_path / "out").iterdir())


def test_scenes_overwrite_only_by_force(scenes, tmp_path):
    assert scenes("-n", 3)[0] == 0
    chosen = names(tmp_path / "out")
    (tmp_path / "out" / chosen[1]).write_bytes(b"mine")
    (tmp_path / "out" / chosen[2]).unlink()
    code, _, err = scenes("-n", 3)
    assert code == 1 and err.count("\n") == 1 and "--force" in err
    assert any(str(tmp_path / "out" / name) in err for name in chosen[:2])
    assert (tmp_path / "out" / chosen[1]).read_bytes() == b"mine" and names(tmp_path / "out") == chosen[:2]
    assert scenes("-n", 3, "--force")[0] == 0
    assert names(tmp_path / "out") == chosen and load_npz(tmp_path / "out" / chosen[1]).num_lanes > 0


def test_scenes_have_safe_names_that_differ(scenes, records, tmp_path, monkeypatch):
    """Ids of recordings are any texts, and two recordings may have the same."""
    ids = ["../../etc/passwd", "a" * 300, "Straße 5/北京", "", "same", "same"]
    changed = iter(range(10**6))

    def decode(data):
        return dataclasses.replace(decode_record(data), scene_id=ids[next(changed) % len(ids)])

    monkeypatch.setattr("scjax.data.records.decode_record", decode)
    assert scenes("-n", len(ids))[0] == 0
    assert len(names(tmp_path / "out")) == len(ids) and all(len(name) < 100 for name in names(tmp_path / "out"))
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-n", "0"), "-n is 0"),
        (("-n", "-3"), "-n is -3"),
        (("-n", "5000"), "give -n"),
        (("-n", "5000", "--split", "val"), "of val: give -n"),
        (("--seed", "-1"), "seed is -1"),
        (("--seed", str(2**63)), "seed is"),
    ],
)
def test_scenes_bad_value_exits_1(scenes, tmp_path, options, message):
    code, out, err = scenes(*options)
    assert (code, out) == (1, "") and err.startswith("error: ") and message in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_scenes_of_no_records_exits_1(scenes, tmp_path):
    code, _, err = scenes(source=tmp_path)
    assert code == 1 and f"{tmp_path / 'manifest.json'}: not there" in err and not (tmp_path / "out").exists()


def test_scenes_into_a_file_exits_1(scenes, tmp_path):
    (tmp_path / "file").write_text("mine")
    code, _, err = scenes("-n", 1, out=tmp_path / "file")
    assert code == 1 and str(tmp_path / "file") in err and (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("options", [["--format", "xml"], ["--split", "test"], ["-n", "many"], ["--out", ""]])
def test_scenes_wrong_usage_exits_2(scenes, options):
    assert scenes(*options)[0] == 2
