"""ArrayRecord shards: written whole, compared with the manifest when opened, read with errors that name them."""

from __future__ import annotations

import bisect
import concurrent.futures
import contextlib
import errno
import functools
import hashlib
import itertools
import operator
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, SupportsIndex, TypeVar

from array_record.python import array_record_data_source, array_record_module  # pyright: ignore

from scjax.data.manifest import load_manifest
from scjax.scene.files import part_path, remove_stale_parts

T = TypeVar("T")
_NAME = re.compile(r".+-(\d{5})-of-(\d{5})\.arrayrecord")
_THREADS = 8  # that compare and open shards


class FileStamp(NamedTuple):
    """Size in bytes and hash of a file, by which it is known again."""

    bytes: int
    sha256: str


class RecordShards:
    """The encoded records of some shards, in file order: len(), [index] and iteration. Other processes can have it.

    Raises:
      ValueError: a shard cannot be opened, or later a record cannot be read; names the shard and what to do.
    """

    def __init__(self, paths: Iterable[Path]):
        self._paths = list(paths)
        with concurrent.futures.ThreadPoolExecutor(_THREADS) as pool:
            self._sources = list(pool.map(_open_shard, self._paths))
        self._ends = list(itertools.accumulate(map(len, self._sources)))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, index: SupportsIndex) -> bytes:
        shard, position = self._find(index)
        return _readable(
            self._paths[shard], f"record {position} cannot be read", lambda: self._sources[shard][position]
        )

    def __iter__(self) -> Iterator[bytes]:
        return (self[index] for index in range(len(self)))

    def place(self, index: SupportsIndex) -> str:
        """The shard of a record and its number there, for messages."""
        shard, position = self._find(index)
        return f"{self._paths[shard]}: record {position}"

    def _find(self, index: SupportsIndex) -> tuple[int, int]:
        row = operator.index(index)
        if not 0 <= row < len(self):
            raise IndexError(f"record {row} of {len(self)}")
        shard = bisect.bisect_right(self._ends, row)
        return shard, row - self._ends[shard] + len(self._sources[shard])


def open_records(folder: str | Path, split: str) -> RecordShards:
    """The encoded records (bytes, for ``decode_record``) of a split, in file order.

    Shards are compared with their sizes and hashes in the manifest, if it has any.

    Raises:
      ValueError: as ``shard_paths``, or a shard is not the one that the build wrote.
    """
    folder = Path(folder)
    if not (folder / "manifest.json").exists():
        return RecordShards(shard_paths(folder, split))
    manifest = load_manifest(folder)
    entry, stamps = manifest["splits"].get(split, {"shards": [], "records": 0}), manifest.get("files", {})
    for name in entry["shards"]:
        if not (folder / name).exists():
            raise ValueError(f"{folder / name}: not there, but named in manifest.json: {_cure(folder / name)}")
    paths = shard_paths(folder, split)
    if [path.name for path in paths] != entry["shards"]:
        raise ValueError(f"{folder}: its {split} shards are not those of manifest.json: build the records again")
    with concurrent.futures.ThreadPoolExecutor(_THREADS) as pool:
        tuple(pool.map(_compare, paths, [stamps.get(path.name) for path in paths]))
    shards = RecordShards(paths)
    if len(shards) != entry["records"]:
        raise ValueError(
            f"{folder}: its {split} shards hold {len(shards)} records, not the {entry['records']} of manifest.json: "
            "build the records again"
        )
    return shards


def shard_paths(folder: str | Path, split: str) -> list[Path]:
    """The shards of a split in order.

    Raises:
      ValueError: if there are none, or some of them are missing.
    """
    matches = {path: _NAME.fullmatch(path.name) for path in sorted(Path(folder).glob(f"{split}-*.arrayrecord"))}
    paths = {path: int(match[2]) for path, match in matches.items() if match}
    if not paths:
        raise ValueError(f"{folder}: no {split} shards there: run `python -m scjax.data build SOURCE {folder}` first")
    total = max(paths.values())
    expected = [Path(folder, f"{split}-{i:05d}-of-{total:05d}.arrayrecord") for i in range(total)]
    if list(paths) != expected:
        missing = [path.name for path in expected if path not in paths]
        detail = f"{missing[0]} is missing" if missing else "there are more"
        raise ValueError(
            f"{folder}: {split} shards are not the complete set of {total} ({detail}): finish or repeat the build"
        )
    return list(paths)


def write_shard(path: Path, records: Iterable[bytes]) -> int:
    """Writes an ArrayRecord shard, complete or not at all, and returns its number of records.

    Raises:
      OSError: naming the file, if it cannot be written.
    """
    remove_stale_parts(path.parent, path.name)
    temporary = part_path(path)
    writer = _writing(path, lambda: array_record_module.ArrayRecordWriter(str(temporary), "group_size:1,zstd:3"))
    count = 0
    try:
        for data in records:
            _writing(path, lambda: writer.write(data))  # noqa: B023 (called at once)
            count += 1
        _writing(path, writer.close)
        _writing(path, lambda: temporary.replace(path))
    finally:
        with contextlib.suppress(RuntimeError):
            writer.close()
        temporary.unlink(missing_ok=True)
    return count


def stamp_file(path: Path) -> FileStamp:
    """Size and sha256 of a file; it is read once a process as long as it is not changed."""
    state = path.stat()
    return FileStamp(state.st_size, _sha256(path, state.st_size, state.st_mtime_ns, state.st_ino))


@functools.lru_cache(1 << 16)
def _sha256(path: Path, *state: int) -> str:
    del state
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _compare(path: Path, stamp: dict[str, Any] | None) -> None:
    """Raises a ValueError if the file is not the one of the stamp; None: it has none, as in older manifests."""
    if stamp is None:
        return
    try:
        size = path.stat().st_size
        is_same = size == stamp["bytes"] and stamp_file(path).sha256 == stamp["sha256"]
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}): {_cure(path)}") from error
    if not is_same:
        fault = (
            f"has {size} bytes, not the {stamp['bytes']}" if size != stamp["bytes"] else "holds other bytes than those"
        )
        raise ValueError(f"{path}: {fault} of manifest.json, so one of them was changed: {_cure(path)}")


def _open_shard(path: Path) -> Any:
    return _readable(
        path, "it is no shard of records", lambda: array_record_data_source.ArrayRecordDataSource(str(path))
    )


def _readable(path: Path, fault: str, read: Callable[[], T]) -> T:
    """The result of ``read``, whose errors become one that names the shard."""
    try:
        return read()
    except Exception as error:  # array_record raises RuntimeError, IndexError and ValueError for damaged bytes
        raise ValueError(f"{path}: {fault} ({_first_line(error)}): {_cure(path)}") from error


def _cure(path: Path) -> str:
    return f"copy it again, or run `python -m scjax.data build SOURCE {path.parent}`"


def _writing(path: Path, write: Callable[[], T]) -> T:
    """The result of ``write``, whose errors become an OSError that names the file."""
    try:
        return write()
    except OSError as error:
        raise type(error)(error.errno, error.strerror or str(error), str(path)) from error
    except RuntimeError as error:  # of array_record, with the words of the operating system in it
        code = errno.ENOSPC if "No space left" in str(error) else errno.EIO
        raise OSError(code, f"the shard cannot be written ({_first_line(error)})", str(path)) from error


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].split("; ")[0]
