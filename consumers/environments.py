"""The virtual environments of the consumers, one for each ``requirements-NAME.txt``."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

FOLDER = Path(__file__).parent
NAMES = tuple(sorted(path.stem.removeprefix("requirements-") for path in FOLDER.glob("requirements-*.txt")))
"""Consumers that have an environment."""


def default_root() -> Path:
    """The folder of the environments: ``SCJAX_CONSUMERS``, or ``scjax/consumers`` in the user's cache."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return Path(os.environ.get("SCJAX_CONSUMERS", cache / "scjax" / "consumers"))


def python_of(name: str, root: Path | None = None) -> Path | None:
    """The interpreter of a consumer's environment; None if it is not there or not complete."""
    folder = (root or default_root()) / name
    return folder / "bin" / "python" if (folder / "complete").is_file() else None


def make_environment(name: str, root: Path | None = None) -> Path:
    """Installs the pinned packages of a consumer; returns its folder. One that is complete stays as it is.

    Raises:
      ValueError: there is no such consumer, or its packages cannot be installed.
    """
    if name not in NAMES:
        raise ValueError(f"{name!r} is no consumer: choose from {', '.join(NAMES)}")
    folder = (root or default_root()) / name
    requirements = FOLDER / f"requirements-{name}.txt"
    complete = folder / "complete"
    if complete.is_file() and complete.read_text() == requirements.read_text():
        return folder
    complete.unlink(missing_ok=True)
    venv.create(folder, with_pip=True, clear=folder.exists())
    pip = [str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    if subprocess.run([*pip, "--requirement", str(requirements)], stdout=sys.stderr).returncode:
        raise ValueError(f"{folder}: pip cannot install {requirements.name}: see its message above")
    if name == "metadrive":
        _write_stub_assets(folder)
    complete.write_text(requirements.read_text())
    return folder


def _write_stub_assets(folder: Path) -> None:
    """The two files without which MetaDrive downloads its textures at the first reset; replay needs none of them."""
    assets = next(folder.glob("lib/python*/site-packages/metadrive")) / "assets"
    pin = (FOLDER / "requirements-metadrive.txt").read_text().split()[0]
    texture = assets / "textures" / "grass1" / "GroundGrassGreen002_COL_1K.jpg"
    texture.parent.mkdir(parents=True, exist_ok=True)
    texture.touch()
    (assets / "version.txt").write_text(pin.partition("==")[2])
