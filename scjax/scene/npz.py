"""Arrays in ``.npz`` files from outside: names, types and sizes are checked before anything is allocated."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scjax.scene.files import MEGABYTE, size_limit


def read_npz(
    path: str | Path, kinds: Mapping[str, str], cure: str, *, optional: frozenset[str] = frozenset()
) -> dict[str, np.ndarray]:
    """The arrays named in ``kinds``; others in the file are not read.

    Args:
      kinds: name -> kind of the dtype ("f", "i", "b", "U", or several of them).
      cure: what the user shall do, for the end of a message.
      optional: names that may be missing.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: naming the file and the array: damaged, missing, of another kind, or larger than the file allows.
    """
    path = Path(path)
    arrays: dict[str, np.ndarray] = {}
    name = ""
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
            limit = size_limit(path.stat().st_size)
            for name in kinds:
                if name in members:
                    arrays[name] = _read_array(archive, members[name], limit)
                    limit -= arrays[name].nbytes
    except FileNotFoundError:
        raise
    except Exception as error:  # zipfile and the header's parser raise many kinds for damaged bytes
        where = f"array {name!r}: " if name else ""
        raise ValueError(f"{path} is no readable .npz file ({where}{error or type(error).__name__}): {cure}") from error
    if missing := sorted(set(kinds) - set(arrays) - optional):
        raise ValueError(f"{path} lacks the arrays {missing}: {cure}")
    for name, array in arrays.items():
        if array.dtype.kind not in kinds[name]:
            raise ValueError(f"{path}: {name} has the type {array.dtype}: {cure}")
    return arrays


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, limit: int) -> np.ndarray:
    with archive.open(member) as file:
        shape, fortran, dtype = _read_header(file)
        size = math.prod(shape) * dtype.itemsize
        if dtype.hasobject or dtype.kind not in "biufU":
            raise ValueError(f"it holds {dtype}")
        if size > limit or size > member.file_size:
            raise ValueError(f"its header declares {size / MEGABYTE:.0f} MB")
        data = file.read(size + 1)
    if len(data) != size:
        raise ValueError(f"it has {len(data)} bytes, its header declares {size}")
    array = np.frombuffer(bytearray(data), dtype).reshape(shape, order="F" if fortran else "C")
    return array.view(np.uint8) != 0 if dtype.kind == "b" else array  # a byte of 2 is a broken boolean


def _read_header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    return reader(file)
