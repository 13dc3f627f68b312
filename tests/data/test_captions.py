"""Captions beside records: every record has one, files are whole, other people's files are read."""

import gzip
import itertools
import json
import shutil

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scjax.cli.data import main
from scjax.data import records
from scjax.data.build import build_records
from scjax.data.captions import add_captions, read_captions, read_official
from scjax.language.analysis.scene_analysis import analyze
from scjax.language.attributes.table import score_attributes
from scjax.language.grammar.styles import STYLES
from scjax.synthetic.source import Worlds
from tests.factories.damage import damaged_bytes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("captions")
    build_records(Worlds(2, 2), root / "records")
    assert main(["caption", str(root / "records"), "--texts", "9", "--workers", "1"]) == 0
    return root / "records"


def test_captions_cover_every_record(folder):
    tiles = records.open_records(folder, "train")
    captions = list(read_captions(folder, "train"))
    assert len(captions) == len(tiles)
    assert all(len(caption.texts) == 9 for caption in captions)
    assert not list(folder.glob(".captions*"))


def test_captions_ask_for_what_their_records_show(folder):
    tiles = records.open_records(folder, "train")
    for row, caption in enumerate(itertools.islice(read_captions(folder, "train"), 5)):
        analysis = analyze(records.sample_scene(records.decode_record(tiles[row])))
        for composition in caption.compositions:
            assert composition.request and not score_attributes(analysis, composition.request).misses


def test_captions_are_in_many_styles_and_languages(folder):
    compositions = [item for caption in read_captions(folder, "train") for item in caption.compositions]
    assert {item.style for item in compositions} == set(STYLES)
    assert len({item.language for item in compositions}) > 5


def test_captions_follow_rebuilt_records(tmp_path):
    for seed in (1, 2):
        shutil.rmtree(tmp_path / "records", ignore_errors=True)
        build_records(Worlds(seed, 1), tmp_path / "records")
        assert main(["caption", str(tmp_path / "records"), "--texts", "2", "--workers", "0"]) == 0
        tiles = records.open_records(tmp_path / "records", "train")
        captions = list(read_captions(tmp_path / "records", "train"))
        assert len(captions) == len(tiles)
        for row in (0, len(tiles) // 2, len(tiles) - 1):
            scene = records.sample_scene(records.decode_record(tiles[row]))
            assert all(not score_attributes(scene, item.request).misses for item in captions[row].compositions)


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


def test_captions_again_are_equal_bytes(folder):
    """By this process or by a worker. Otherwise features of the captions would be thrown away; gzip writes the time."""
    path = folder / "captions-train.jsonl.gz"
    original = path.read_bytes()
    assert original[:10] == b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x02\xff"  # no flags, no time
    assert main(["caption", str(folder), "--texts", "9", "--workers", "0"]) == 0
    assert path.read_bytes() == original


@pytest.fixture
def copy(folder, tmp_path):
    """A folder with captions that may be damaged."""
    for name in ("manifest.json", "captions-train.jsonl.gz"):
        shutil.copy(folder / name, tmp_path / name)
    return tmp_path


def _rewrite(folder, change):
    path = folder / "captions-train.jsonl.gz"
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    change(lines)
    path.write_bytes(gzip.compress("".join(f"{line}\n" for line in lines).encode()))


def _edit_request(lines, **request):
    content = json.loads(lines[3])
    content["captions"][0]["request"] |= request
    lines[3] = json.dumps(content)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda lines: lines.__setitem__(3, "{"), "line 4 is no JSON"),
        (lambda lines: lines.__setitem__(3, '{"captions": []}'), "line 4: captions: expected `array` of length"),
        (lambda lines: lines.__setitem__(3, '{"captions": [{"text": 3}]}'), "line 4: captions"),
        (lambda lines: _edit_request(lines, layout="moon"), "line 4: layout has no value 'moon'"),
        (lambda lines: _edit_request(lines, moon=1), "line 4: there is no attribute 'moon'"),
        (lambda lines: lines.__setitem__(0, "[]"), "line 1: expected `object`"),
        (lambda lines: lines.pop(), "holds captions of"),
        (lambda lines: lines.append(lines[-1]), "holds captions of"),
        (list.clear, "line 1 is no JSON"),
    ],
)
def test_read_captions_names_the_line(copy, change, fault):
    _rewrite(copy, change)
    with pytest.raises(ValueError, match=rf"captions-train\.jsonl\.gz.*{fault}.*scjax\.data caption"):
        list(read_captions(copy, "train"))


def test_read_captions_of_a_truncated_file(copy):
    path = copy / "captions-train.jsonl.gz"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ValueError, match=r"captions-train\.jsonl\.gz, line \d+: the file is damaged"):
        list(read_captions(copy, "train"))


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(draw=st.data())
def test_read_captions_of_damaged_files(folder, copy, draw):
    path = copy / "captions-train.jsonl.gz"
    path.write_bytes(draw.draw(damaged_bytes((folder / path.name).read_bytes())))
    try:
        number = len(list(read_captions(copy, "train")))
    except ValueError as error:
        assert str(path) in str(error) and "\n" not in str(error)
    else:
        assert number == len(records.open_records(folder, "train"))


def test_captions_stay_as_they_are_if_records_cannot_be_read(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "records")
    before = (copy / "captions-train.jsonl.gz").read_bytes()
    shard = copy / "train-00000-of-00001.arrayrecord"
    shard.write_bytes(shard.read_bytes()[:-9])
    with pytest.raises(ValueError, match=r"train-00000-of-00001\.arrayrecord: has"):
        add_captions(copy, progress=False)
    assert (copy / "captions-train.jsonl.gz").read_bytes() == before and not list(copy.glob(".*.part"))


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
