"""Arrays in safetensors files of bounded size, each with its hash: what a model folder is made of."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy


def write_arrays(
    arrays: Mapping[str, np.ndarray], folder: Path, *, dtype: str | None = None, largest: float | None = None,
    exact: Collection[str] = (),
) -> dict[str, str]:  # fmt: skip
    """Writes ``weights.safetensors``, or ``weights-1.safetensors``, ...; returns file name -> sha256.

    Args:
      dtype: floating-point arrays are stored in it ("float16" halves a folder); None: as they are.
      exact: names of arrays that are stored as they are all the same.
      largest: megabytes of a file at most; None: one file.

    Raises:
      ValueError: an array alone is larger than that.
    """
    # safetensors writes an array's memory as it lies, whatever its strides: a transposed one would come back garbled.
    stored = {}
    for name, value in arrays.items():
        converts = np.issubdtype(value.dtype, np.floating) and name not in exact
        stored[name] = np.array(value, dtype if converts else None, order="C")
    parts: list[dict[str, np.ndarray]] = [{}]
    size = 0.0
    for name, value in stored.items():
        megabytes = value.nbytes / 1e6
        if largest is not None and megabytes > largest:
            raise ValueError(f"{name} has {megabytes:.1f} MB, more than a file of {largest:g} MB may hold: allow more")
        if largest is not None and parts[-1] and size + megabytes > largest:
            parts.append({})
            size = 0.0
        parts[-1][name] = value
        size += megabytes
    hashes = {}
    for number, part in enumerate(parts, 1):
        name = "weights.safetensors" if len(parts) == 1 else f"weights-{number}.safetensors"
        (folder / name).write_bytes(safetensors.numpy.save(part))  # save_file would shut all but the owner out
        hashes[name] = _sha256(folder / name)
    return hashes


def read_arrays(folder: Path, files: Mapping[str, str]) -> dict[str, np.ndarray]:
    """All arrays, float32 where they are stored in less.

    Args:
      files: file name -> sha256, or "" where it is not known.

    Raises:
      ValueError: naming a file that is missing, damaged or not the one that was written.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, digest in files.items():
        path = folder / name
        if not path.is_file():
            raise ValueError(f"{path} is missing: copy or export the model again")
        if digest and _sha256(path) != digest:
            raise ValueError(f"{path} is damaged (its sha256 is not the recorded one): copy or export the model again")
        try:
            arrays |= safetensors.numpy.load_file(path)
        except (OSError, safetensors.SafetensorError) as error:
            raise ValueError(f"{path} is damaged ({error}): copy or export the model again") from error
    return {name: value.astype(np.float32) if value.dtype == np.float16 else value for name, value in arrays.items()}


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
