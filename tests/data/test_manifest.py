"""manifest.json: whatever is wrong in it is named by its place."""

import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scjax.data.build import build_records, load_manifest
from scjax.data.build_options import BuildOptions
from scjax.synthetic.source import Worlds
from tests.factories.damage import damaged_bytes, damaged_json


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    folder = tmp_path_factory.mktemp("manifest")
    build_records(Worlds(3, 4), folder, BuildOptions(split_percent=30.0, files_per_shard=2))
    return json.loads((folder / "manifest.json").read_text())


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(draw=st.data())
def test_load_manifest_of_damaged_content(content, tmp_path, draw):
    path = tmp_path / "manifest.json"
    as_json = draw.draw(st.booleans())
    text = json.dumps(draw.draw(damaged_json(content)) if as_json else content).encode()
    path.write_bytes(text if as_json else draw.draw(damaged_bytes(text)))
    try:
        manifest = load_manifest(tmp_path)
    except ValueError as error:
        assert str(path) in str(error) and "build the records again" in str(error) and "\n" not in str(error)
    else:
        assert all(row[0] < len(manifest["domains"]) for row in manifest["counts"])


def _set(*path, value):
    def damage(content):
        for key in path[:-1]:
            content = content[key]
        content[path[-1]] = value

    return damage


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        (_set("domains", value="town"), r"domains: expected `array`"),
        (_set("domains", value=["town", "town"]), r"domains: holds a name twice"),
        (_set("counts", 0, 0, value=99), r"counts\[0\]\[0\]: there are only"),
        (_set("counts", 0, 1, value=-1), r"counts\[0\]\[1\]: expected `int` >= 0"),
        (_set("counts", 0, 1, value=101), r"counts\[0\]\[1\]: expected `int` <= 100"),
        (_set("counts", 0, 3, value=10**9), r"counts: \d+ tiles of only"),
        (_set("counts", 0, value=[0, 1]), r"counts\[0\]: expected `array` of length 4"),
        (_set("splits", "train", "records", value="9"), r"splits\.train\.records: expected `int`"),
        (_set("splits", "train", "shards", value=[]), r"splits\.train\.records: \d+ without a shard"),
        (_set("splits", "train", "shards", 0, value="../x"), r"splits\.train\.shards\[0\]: expected `str`"),
        (_set("hash", value=3), r"hash: expected `str`"),
        (lambda content: content.pop("splits"), r"missing required field `splits`"),
        (lambda content: content["splits"].pop("val"), r"splits: object missing required field `val`"),
    ],
)
def test_load_manifest_names_the_field(content, tmp_path, damage, fault):
    content = json.loads(json.dumps(content))
    damage(content)
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=rf"manifest\.json: .*{fault}.*: build the records again"):
        load_manifest(tmp_path)


def test_load_manifest_accepts_older_and_newer_keys(content, tmp_path):
    content = {**content, "unknown": {"words": 3}}
    del content["files"]
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    assert load_manifest(tmp_path) == content


def test_load_manifest_of_a_folder_in_its_place(tmp_path):
    (tmp_path / "manifest.json").mkdir()
    with pytest.raises(ValueError, match=r"manifest\.json"):
        load_manifest(tmp_path)
