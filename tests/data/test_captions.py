"""Captions beside records: every record has one, files are whole, other people's files are read."""

import gzip
import json
import shutil

import pytest

from scjax.cli.data import main
from scjax.data import records
from scjax.data.build import build_records
from scjax.data.captions import read_captions, read_official
from scjax.language.captioner import STYLES
from scjax.language.facts import extract_facts
from scjax.synthetic.source import Worlds


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("captions")
    build_records(Worlds(1, 4), root / "records")
    assert main(["caption", str(root / "records"), "--paraphrases", "3"]) == 0
    return root / "records"


def test_captions_cover_every_record(folder):
    tiles = records.open_records(folder, "train")
    captions = list(read_captions(folder, "train"))
    assert len(captions) == len(tiles)
    for row in (0, len(tiles) // 2, len(tiles) - 1):
        assert captions[row].facts == extract_facts(records.sample_scene(records.decode_record(tiles[row])))
        assert all(len(captions[row].texts[style]) == 3 for style in STYLES)
    assert not list(folder.glob(".captions*"))


def test_captions_do_not_depend_on_workers(folder):
    path = folder / "captions-train.jsonl.gz"
    original = path.read_bytes()
    try:
        assert main(["caption", str(folder), "--paraphrases", "3", "--workers", "0"]) == 0
        assert gzip.decompress(path.read_bytes()) == gzip.decompress(original)  # the fixture's are by two
    finally:
        path.write_bytes(original)


def test_captions_without_drop_are_longer(folder):
    path = folder / "captions-train.jsonl.gz"
    original, some = path.read_bytes(), list(read_captions(folder, "train"))
    try:
        assert main(["caption", str(folder), "--paraphrases", "3", "--workers", "0", "--drop", "0"]) == 0
        every = list(read_captions(folder, "train"))
    finally:
        path.write_bytes(original)
    pairs = [(dropped.texts["long"], complete.texts["long"]) for dropped, complete in zip(some, every, strict=True)]
    assert all(len(more) >= len(less) for texts in pairs for less, more in zip(*texts, strict=True))
    assert sum(less != more for texts in pairs for less, more in zip(*texts, strict=True)) > len(pairs)


def test_captions_follow_rebuilt_records(tmp_path):
    for seed in (1, 2):
        shutil.rmtree(tmp_path / "records", ignore_errors=True)
        build_records(Worlds(seed, 3), tmp_path / "records")
        assert main(["caption", str(tmp_path / "records"), "--workers", "0"]) == 0
        tiles = records.open_records(tmp_path / "records", "train")
        for row, caption in enumerate(read_captions(tmp_path / "records", "train")):
            assert caption.facts == extract_facts(records.sample_scene(records.decode_record(tiles[row])))


def test_read_captions_refuses_other_records(folder, tmp_path):
    path = folder / "captions-train.jsonl.gz"
    original = path.read_bytes()
    lines = gzip.decompress(original).decode().splitlines()
    try:
        path.write_bytes(gzip.compress("\n".join([json.dumps({"format": 1, "records": "x"}), *lines[1:]]).encode()))
        with pytest.raises(ValueError, match="other records"):
            next(read_captions(folder, "train"))
    finally:
        path.write_bytes(original)
    with pytest.raises(ValueError, match="is not there: run python"):
        next(read_captions(folder, "nothing"))


def test_read_official(tmp_path):
    (tmp_path / "val").mkdir()
    path = tmp_path / "val" / "log_7_0_captions.json"
    path.write_text(json.dumps({"BEV": "The scene is a T-intersection.", "FRONT": "x"}))
    assert read_official(tmp_path, "val", "log_7") == "The scene is a T-intersection."
    assert read_official(tmp_path, "val", "log_8") is None
    for content in ("{", "[]", '{"FRONT": 1}', '{"BEV": 3}'):
        path.write_text(content)
        with pytest.raises(ValueError, match="log_7_0_captions"):
            read_official(tmp_path, "val", "log_7")
