"""Arrays in safetensors files of bounded size, each with its hash: the weights of a model folder."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from scjax.nn.functional import Params, flatten, unflatten


def write_arrays(
    arrays: Mapping[str, np.ndarray],
    folder: Path,
    *,
    dtype: str | None = None,
    largest: float | None = None,
    exact: Collection[str] = (),
) -> dict[str, str]:
    """Writes ``weights.safetensors``, or ``weights-1.safetensors``, ...; returns file name -> sha256.

    Args:
      dtype: type of stored floating-point arrays ("float16" halves a folder); None: unchanged.
      exact: names of arrays that keep their type.
      largest: size limit of a file [MB]; None: one file.

    Raises:
      ValueError: a single array exceeds ``largest``.
    """
    # safetensors writes raw memory and ignores strides: a transposed array would be read back garbled.
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
        (folder / name).write_bytes(safetensors.numpy.save(part))  # save_file makes files readable by their owner only
        hashes[name] = sha256_of(folder / name)
    return hashes


def read_arrays(folder: Path, files: Mapping[str, str]) -> dict[str, np.ndarray]:
    """All arrays; float16 is converted to float32.

    Args:
      files: file name -> sha256, or "" if unknown.

    Raises:
      ValueError: a file is missing or damaged, or its hash differs.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, digest in files.items():
        path = folder / name
        if Path(name).name != name:
            raise ValueError(f"{path} lies in another folder: copy or export the model again")
        if not path.is_file():
            raise ValueError(f"{path} is missing: copy or export the model again")
        if digest and sha256_of(path) != digest:
            raise ValueError(f"{path} is damaged (its sha256 is not the recorded one): copy or export the model again")
        try:
            arrays |= safetensors.numpy.load_file(path)
        except Exception as error:  # the library raises many kinds for damaged bytes
            raise ValueError(f"{path} is damaged ({error}): copy or export the model again") from error
    return {name: value.astype(np.float32) if value.dtype == np.float16 else value for name, value in arrays.items()}


def array_names(params: Params) -> dict[str, np.ndarray]:
    """Dotted name -> array of a parameter tree."""
    return {".".join(map(str, path)): np.asarray(leaf) for path, leaf in flatten(params).items()}


def named_arrays(arrays: Mapping[str, np.ndarray]) -> Params:
    """The inverse of ``array_names``; positions in lists of modules are numbers."""
    return unflatten(
        {tuple(int(part) if part.isdigit() else part for part in name.split(".")): a for name, a in arrays.items()}
    )


def sha256_of(path: Path) -> str:
    """The hash of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
