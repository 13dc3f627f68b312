import json

import numpy as np
import pytest

from scjax.data import records
from scjax.data.build import build_records, load_manifest, split_of
from scjax.data.build_options import BuildOptions, PoseOptions
from scjax.data.build_shards import build_shard
from scjax.data.readers import LogInfo, LogReader
from scjax.data.record_source import ReaderSource
from scjax.scene import LogMetadata, validate
from tests.factories import scene_files
from tests.factories.logs import example_log

OPTIONS = BuildOptions(split_percent=30.0, files_per_shard=2)
TRAIN = [f"town {k}" for k in range(20) if split_of("womd", f"town {k}", 30.0) == "train"]
VAL = [f"town {k}" for k in range(20) if split_of("womd", f"town {k}", 30.0) == "val"]


@pytest.fixture
def source(tmp_path):
    """Five training files, two of one town, and one validation file; pictures and peers to be left out."""
    folder = tmp_path / "scenes"
    for number, cluster in enumerate([*TRAIN[:4], TRAIN[0], VAL[0]]):
        scene_files.write_scene_file(folder / "womd", scene_files.scene_content(f"scene {number}", cluster))
    scene_files.write_scene_file(folder / "peer_outputs", scene_files.scene_content("generated"))
    scene_files.write_scene_file(folder / "images_boxes_only", scene_files.scene_content("picture"))
    return folder


def stamps(folder):
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("*.arrayrecord")}


def test_build_records_match_manifest_and_index(source, tmp_path):
    out = tmp_path / "records"
    manifest = build_records(source, out, OPTIONS)
    assert manifest == load_manifest(out)
    assert manifest["domains"] == ["womd"] and not manifest["skipped"]
    assert manifest["splits"]["val"]["clusters"] == [f"womd/{VAL[0]}"]
    assert len(manifest["splits"]["train"]["shards"]) == 3 and len(manifest["sources"]) == 6
    for split in ("train", "val"):
        entry, source_ = manifest["splits"][split], records.open_records(out, split)
        decoded = [records.decode_record(data) for data in source_]
        assert len(decoded) == entry["records"] > 0
        assert {f"womd/{record.cluster}" for record in decoded} == set(entry["clusters"])
        scenes = [validate(records.sample_scene(record)) for record in decoded]
        with np.load(out / f"{split}-index.npz") as index:
            assert index["step"].tolist() == [record.step for record in decoded]
            assert index["num_lanes"].tolist() == [len(scene.lanes) for scene in scenes]
            assert index["num_agents"].tolist() == [len(scene.agents) for scene in scenes]
            standard = index["is_standard"].sum()
        if split == "val":
            assert standard == len(decoded) == 2
        else:
            assert standard == 10 and len(decoded) > 20
            assert sum(row[-1] for row in manifest["counts"]) == 10
            speeds = np.concatenate([s.agents[s.agent_types == 0, 3] for s in scenes])
            summary = manifest["statistics"]["agents"]["vehicle"]["speed"]
            assert summary["count"] == len(speeds)
            np.testing.assert_allclose([summary["mean"], summary["std"]], [speeds.mean(), speeds.std()], rtol=1e-4)
    assert not list(out.glob(".*.part"))


def test_build_without_extra_training_poses(source, tmp_path):
    options = BuildOptions(split_percent=0.0, train_poses=PoseOptions())
    manifest = build_records(source, tmp_path / "records", options)
    assert manifest["splits"]["train"]["records"] == 12 and manifest["splits"]["val"]["records"] == 0


def test_finished_shards_are_kept(source, tmp_path):
    out = tmp_path / "records"
    first = build_records(source, out, OPTIONS)
    before = stamps(out)
    assert build_records(source, out, OPTIONS) == first
    assert stamps(out) == before

    # A changed source file rebuilds its shard alone.
    scene_files.write_scene_file(source / "womd", scene_files.scene_content("scene 0", TRAIN[0], dt=0.100001))
    second = build_records(source, out, OPTIONS)
    changed = {name for name, stamp in stamps(out).items() if stamp != before[name]}
    assert changed == {"train-00000-of-00003.arrayrecord"} and second["hash"] != first["hash"]

    # So do a damaged shard and --no-resume.
    shard = out / "train-00001-of-00003.arrayrecord"
    shard.write_bytes(b"short")
    build_records(source, out, OPTIONS)
    assert shard.stat().st_size > 5
    before = stamps(out)
    build_records(source, out, OPTIONS, resume=False)
    assert not set(stamps(out).items()) & set(before.items())


def test_killed_build_continues(source, tmp_path):
    out, whole = tmp_path / "records", tmp_path / "whole"
    reference = build_records(source, whole, OPTIONS)
    calls = []

    def killed_at_third(task):
        calls.append(task)
        if len(calls) == 3:
            (out / f".{task[2].name}.arrayrecord.1.part").write_bytes(b"half a shard")
            raise KeyboardInterrupt
        return build_shard(task)

    with pytest.raises(KeyboardInterrupt):
        build_records(source, out, OPTIONS, make_shard=killed_at_third)
    before = stamps(out)
    assert len(before) == 2
    with pytest.raises(ValueError, match="to its end"):
        load_manifest(out)
    assert build_records(source, out, OPTIONS) == reference
    assert before.items() <= stamps(out).items() and not list(out.glob(".*.part"))
    for name in stamps(whole):
        assert (whole / name).read_bytes() == (out / name).read_bytes()


def test_build_removes_shards_of_earlier_plans(source, tmp_path):
    out = tmp_path / "records"
    build_records(source, out, OPTIONS)
    manifest = build_records(source, out, BuildOptions(split_percent=30.0, files_per_shard=16))
    assert set(stamps(out)) == {name for entry in manifest["splits"].values() for name in entry["shards"]}


def test_build_workers_give_the_same_bytes(source, tmp_path):
    single = build_records(source, tmp_path / "one", OPTIONS)
    parallel = build_records(source, tmp_path / "two", OPTIONS, workers=2)
    assert single == parallel
    for name in stamps(tmp_path / "one"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def write_bad_scenes(source):
    bad = scene_files.scene_content("bad nan", TRAIN[1])
    bad["map"][0]["x"][5] = float("nan")
    scene_files.write_scene_file(source / "womd", bad)
    path = scene_files.write_scene_file(source / "womd", scene_files.scene_content("bad truncated"))
    path.write_bytes(path.read_bytes()[:-20])
    scene_files.write_scene_file(source / "womd", scene_files.scene_content("bad schema", schema="other"))
    scene_files.write_scene_file(source / "womd", scene_files.scene_content("bad map", TRAIN[2], map=[]))
    parked = scene_files.scene_content(
        "no poses", TRAIN[3], objects=scene_files.scene_content()["objects"][2:3], sdc_index=None
    )
    scene_files.write_scene_file(source / "womd", parked)


def test_build_lists_bad_files(source, tmp_path):
    good = build_records(source, tmp_path / "good", OPTIONS)
    write_bad_scenes(source)
    manifest = build_records(source, tmp_path / "records", OPTIONS)
    reasons = {entry["file"]: entry["reason"] for entry in manifest["skipped"]}
    assert set(reasons) == {f"womd/bad {name}.json.gz" for name in ("nan", "truncated", "schema", "map")}
    assert "NaN" in reasons["womd/bad nan.json.gz"] and "gzip" in reasons["womd/bad truncated.json.gz"]
    assert "schema is 'other'" in reasons["womd/bad schema.json.gz"] and "no lanes" in reasons["womd/bad map.json.gz"]
    assert manifest["without_poses"] == ["womd/no poses.json.gz"]
    assert manifest["splits"]["train"]["records"] == good["splits"]["train"]["records"]


def test_build_strict_stops_at_bad_file(source, tmp_path):
    write_bad_scenes(source)
    with pytest.raises(ValueError, match="--strict"):
        build_records(source, tmp_path / "records", OPTIONS, strict=True)
    with pytest.raises(ValueError, match="to its end"):
        load_manifest(tmp_path / "records")


def test_split_of_is_stable():
    assert split_of("womd", "womd_000", 10.0) == "train"
    names = [f"cluster {k}" for k in range(4000)]
    val_names = {name for name in names if split_of("womd", name, 10.0) == "val"}
    assert 0.08 < len(val_names) / len(names) < 0.12
    assert val_names <= {name for name in names if split_of("womd", name, 20.0) == "val"}
    assert not any(split_of("womd", name, 0.0) == "val" for name in names)


def test_build_notices_changed_files(source, tmp_path):
    def edit_and_build(task):
        scene_files.write_scene_file(source / "womd", scene_files.scene_content("scene 0", TRAIN[0], dt=0.2))
        return build_shard(task)

    manifest = build_records(source, tmp_path / "records", OPTIONS, make_shard=edit_and_build)
    assert "changed while the build ran" in manifest["skipped"][0]["reason"]


@pytest.mark.parametrize("text", ["", "{", "{}", json.dumps({"format": 99, "record_format": 1})])
def test_load_manifest_damaged_file(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(ValueError, match="build the records again"):
        load_manifest(tmp_path)


@pytest.mark.parametrize("options", [{"split_percent": 100.0}, {"files_per_shard": 0}])
def test_build_options_refuse_bad_values(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        BuildOptions(**options)
    with pytest.raises(ValueError, match=r"poses\.spacing"):
        BuildOptions(poses=PoseOptions(spacing=-1.0))


class LogList:
    """A reader of logs in memory."""

    def names(self):
        return ["first", "second"]

    def scan(self, name):
        return LogInfo(name, sha256=name, domain="village", cluster=name)

    def read(self, name):
        return example_log(metadata=LogMetadata(domain="village", location_cluster=name, source_sha256=name))


def test_build_accepts_any_reader(tmp_path):
    assert isinstance(LogList(), LogReader)
    manifest = build_records(ReaderSource(LogList()), tmp_path / "records", BuildOptions(split_percent=0.0))
    assert manifest["domains"] == ["village"] and manifest["splits"]["train"]["scenes"] == 2
    for data in records.open_records(tmp_path / "records", "train"):
        validate(records.sample_scene(records.decode_record(data)))
