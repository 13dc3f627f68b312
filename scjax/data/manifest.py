"""manifest.json of a record folder: what it must hold, and reading it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from scjax.data.record_checks import RECORD_FORMAT
from scjax.scene import MAX_AGENTS, MAX_LANES
from scjax.scene.document import convert_document, parse_document
from scjax.scene.files import read_limited

MANIFEST_FORMAT = 1
_CURE = "build the records again"
_Count = Annotated[int, Meta(ge=0, lt=2**31)]
_Name = Annotated[str, Meta(min_length=1)]
_Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]


class _Split(Struct):
    clusters: list[str]
    scenes: _Count
    records: _Count
    shards: list[Annotated[str, Meta(pattern=r"^[a-z]+-\d{5}-of-\d{5}\.arrayrecord$")]]


class _Splits(Struct):
    train: _Split
    val: _Split


class _Skipped(Struct):
    file: str
    reason: str


class _File(Struct):
    bytes: Annotated[int, Meta(ge=0)]
    sha256: _Sha256


class Manifest(Struct):
    """The fields of manifest.json that programs read; further ones may be there. See ``load_manifest``."""

    hash: _Sha256
    format: int
    record_format: int
    options: dict[str, Any]
    domains: Annotated[list[_Name], Meta(min_length=1, max_length=1000)]
    splits: _Splits
    cleaned: dict[str, _Count]
    skipped: list[_Skipped]
    without_poses: list[str]
    statistics: dict[str, Any]
    counts: list[
        tuple[
            _Count,
            Annotated[int, Meta(ge=0, le=MAX_LANES)],
            Annotated[int, Meta(ge=0, le=MAX_AGENTS)],
            Annotated[int, Meta(ge=1, lt=2**31)],
        ]
    ]
    sources: dict[str, str]
    files: dict[str, _File] = {}


class _Version(Struct):
    format: Any = None
    record_format: Any = None


def load_manifest(folder: str | Path) -> dict[str, Any]:
    """manifest.json of a record folder.

    Keys:
      format, record_format: format numbers.
      hash: of sources and options.
      options: ``BuildOptions``.
      domains: names of the data sets; records hold indices.
      splits: clusters, scenes, records and shards of each split.
      counts: rows of domain, number of lanes, number of agents, number of centered training tiles at standard poses.
      statistics: per column, of training records.
      cleaned: filled sizes and clipped speeds.
      skipped: files and reasons; ``without_poses``: files.
      warnings, notes: files, and what was found in them how often: what looks wrong, what may be of interest. Older
        builds did not write them.
      sources: file -> sha256.
      files: shard -> its size in bytes and sha256; older builds did not write it.

    Raises:
      ValueError: if it is missing (the build is not finished), damaged, of another format, or its values contradict
        each other.
    """
    path = Path(folder) / "manifest.json"
    try:
        data = read_limited(path)
    except FileNotFoundError as error:
        cure = f"run `python -m scjax.data build SOURCE {folder}` to its end"
        raise ValueError(f"{path}: not there, so the records are not complete: {cure}") from error
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}): {_CURE}") from error
    version = parse_document(data, _Version, path, _CURE)
    if version.format != MANIFEST_FORMAT or version.record_format != RECORD_FORMAT:
        raise ValueError(
            f"{path}: format {version.format}/{version.record_format}, this code reads "
            f"{MANIFEST_FORMAT}/{RECORD_FORMAT}: {_CURE}"
        )
    content = parse_document(data, dict, path, _CURE)
    if fault := _find_fault(convert_document(content, Manifest, path, _CURE)) or _not_finite(content, ""):
        raise ValueError(f"{path}: {fault}: {_CURE}")
    return content


def _find_fault(manifest: Manifest) -> str:
    """What is wrong between fields, with the path of one of them; empty if nothing is."""
    if len(set(manifest.domains)) != len(manifest.domains):
        return "domains: holds a name twice"
    for number, (domain, *_) in enumerate(manifest.counts):
        if domain >= len(manifest.domains):
            return f"counts[{number}][0]: there are only {len(manifest.domains)} domains"
    total, records = sum(row[-1] for row in manifest.counts), manifest.splits.train.records
    if total > records:
        return f"counts: {total} tiles of only {records} training records"
    for name in ("train", "val"):
        split = getattr(manifest.splits, name)
        expected = [f"{name}-{k:05d}-of-{len(split.shards):05d}.arrayrecord" for k in range(len(split.shards))]
        if split.shards != expected:
            return f"splits.{name}.shards: is not the complete set of {len(expected)}"
        if split.records and not split.shards:
            return f"splits.{name}.records: {split.records} without a shard"
    return ""


def _not_finite(content: Any, path: str) -> str:
    """The path of the first NaN or infinity, which JSON does not have but Python reads; empty without one."""
    if isinstance(content, float) and not math.isfinite(content):
        return f"{path.removeprefix('.')}: is {content}"
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return next((fault for key, value in items if (fault := _not_finite(value, f"{path}.{key}"))), "")


def file_entry(size: int, sha256: str) -> dict[str, Any]:
    """The entry of a file in the manifest's ``files``."""
    return msgspec.to_builtins(_File(size, sha256))
