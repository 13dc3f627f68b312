"""Shards that are damaged, swapped or missing: one ValueError that names the shard, wherever they are read."""

import errno
import json
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scjax.data import records, shards
from scjax.data.build import build_records, load_manifest
from scjax.data.build_options import BuildOptions
from scjax.data.loader import LoaderConfig, training_batches, validation_scenes
from scjax.models.codec import scjax
from scjax.synthetic.source import Worlds
from tests.factories.damage import damaged_bytes

OPTIONS = BuildOptions(split_percent=30.0, files_per_shard=2)
WORLDS = Worlds(3, 6)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    folder = tmp_path_factory.mktemp("original") / "records"
    build_records(WORLDS, folder, OPTIONS)
    return folder


@pytest.fixture
def folder(original, tmp_path):
    return shutil.copytree(original, tmp_path / "records")


@pytest.fixture
def shard(folder):
    """The first of training."""
    return train_shards(folder)[0]


def train_shards(folder):
    return sorted(folder.glob("train-*.arrayrecord"))


def forget_files(folder):
    """The manifest as older builds wrote it."""
    manifest = load_manifest(folder)
    del manifest["files"]
    (folder / "manifest.json").write_text(json.dumps(manifest))


def truncate(shard):
    shard.write_bytes(shard.read_bytes()[:70_000])


def zero_a_block(shard):
    data = bytearray(shard.read_bytes())
    data[1000:3000] = bytes(2000)
    shard.write_bytes(data)


def swap(shard):
    other = train_shards(shard.parent)[1]
    first, second = shard.read_bytes(), other.read_bytes()
    shard.write_bytes(second)
    other.write_bytes(first)


def test_manifest_holds_size_and_hash_of_every_shard(original):
    files = load_manifest(original)["files"]
    assert set(files) == {path.name for path in original.glob("*.arrayrecord")}
    for name, entry in files.items():
        assert entry == shards.stamp_file(original / name)._asdict()


@pytest.mark.parametrize("damage", [truncate, zero_a_block, swap, lambda shard: shard.unlink()])
def test_open_records_names_a_changed_shard(folder, shard, damage):
    damage(shard)
    with pytest.raises(ValueError, match=rf"{shard.name}: .*copy it again, or run `python -m scjax\.data build"):
        records.open_records(folder, "train")
    assert len(records.open_records(folder, "val"))


@pytest.mark.parametrize("damage", [truncate, zero_a_block, lambda shard: shard.unlink()])
def test_build_again_mends_the_shards(folder, shard, original, damage):
    damage(shard)
    build_records(WORLDS, folder, OPTIONS)
    assert list(records.open_records(folder, "train")) == list(records.open_records(original, "train"))


def test_open_records_of_older_manifests(folder, original):
    forget_files(folder)
    assert list(records.open_records(folder, "train")) == list(records.open_records(original, "train"))


def test_damaged_records_are_named_when_they_are_read(folder, shard):
    forget_files(folder)
    zero_a_block(shard)
    stored = records.open_records(folder, "train")
    with pytest.raises(ValueError, match=rf"{shard.name}: record 0 cannot be read"):
        list(stored)
    with pytest.raises(ValueError, match=rf"{shard.name}: record \d+ cannot be read"):
        batches = training_batches(folder, scjax(), LoaderConfig(batch_size=4, buckets=((61, 100),), workers=2))
        for _ in range(len(stored)):
            next(batches)
    with pytest.raises(ValueError, match=rf"{shard.name}: record 0 cannot be read"):
        validation_scenes(folder, scjax(), split="train")


def test_read_record_names_a_record_that_cannot_be_decoded(tmp_path):
    records.write_shard(tmp_path / "val-00000-of-00001.arrayrecord", [b"no record"])
    stored = records.open_records(tmp_path, "val")
    with pytest.raises(ValueError, match=r"val-00000-of-00001\.arrayrecord: record 0: data: 9 bytes, but no scene"):
        records.read_record(stored, 0)
    with pytest.raises(IndexError):
        stored[1]


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(draw=st.data(), with_files=st.booleans())
def test_damaged_shards_are_refused_or_read(folder, shard, original, draw, with_files):
    manifest = json.loads((original / "manifest.json").read_text())
    if not with_files:
        del manifest["files"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    whole = (original / shard.name).read_bytes()
    shard.write_bytes(draw.draw(damaged_bytes(whole)))
    try:
        stored = records.open_records(folder, "train")
        content = [records.read_record(stored, row) for row in range(len(stored))]
    except ValueError as error:
        assert str(folder) in str(error) and "\n" not in str(error)
    else:
        assert len(content) == manifest["splits"]["train"]["records"]


class _FullDisk:
    """A writer that fails as array_record does on a full disk."""

    def __init__(self, path, options):
        with open(path, "wb") as file:
            file.write(b"half")

    def write(self, data):
        raise RuntimeError("write() failed: No space left on device; writing part; at byte 7")

    def close(self):
        raise RuntimeError("close() failed: No space left on device")


def test_write_shard_names_the_file_of_a_full_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(shards.array_record_module, "ArrayRecordWriter", _FullDisk)
    with pytest.raises(OSError, match=r"cannot be written.*No space left on device.*train-00000") as caught:
        records.write_shard(tmp_path / "train-00000-of-00001.arrayrecord", [b"record"])
    assert caught.value.errno == errno.ENOSPC and not list(tmp_path.iterdir())


def test_write_shard_into_a_missing_folder(tmp_path):
    with pytest.raises(OSError, match=r"cannot be written.*nowhere/train-00000"):
        records.write_shard(tmp_path / "nowhere" / "train-00000-of-00001.arrayrecord", [b"record"])


def test_build_refuses_shards_of_others(folder):
    stranger = folder / "train-00007-of-00009.arrayrecord"
    stranger.write_bytes(b"of another program")
    with pytest.raises(ValueError, match="was not written by this build: remove it"):
        build_records(WORLDS, folder, OPTIONS)
    assert stranger.exists()


def test_record_shards_can_be_sent_to_other_processes(original):
    import pickle

    stored = records.open_records(original, "train")
    assert list(pickle.loads(pickle.dumps(stored))) == list(stored)
    assert stored[np.int64(1)] == stored[1]
