"""Lines of text packed by gzip beside records, a head and one line for each record, in record order."""

from __future__ import annotations

import functools
import gzip
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tqdm import tqdm

from scjax.data import records
from scjax.data.manifest import load_manifest
from scjax.data.record_folder import locked_records
from scjax.data.records import SceneRecord
from scjax.data.workers import WorkerPool
from scjax.scene.files import MEGABYTE, whole_file

_MAX_LINE = MEGABYTE  # bytes


def write_lines(
    folder: Path,
    path_of: Callable[[Path, str], Path],
    head_of: Callable[[dict[str, Any]], bytes],
    line_of: Callable[[SceneRecord, int], bytes],
    *,
    label: str,
    workers: int,
    progress: bool,
) -> dict[str, int]:
    """Writes one file for each split of records; returns the number of records of each.

    Args:
      path_of: (folder, split) -> the file.
      head_of: manifest -> the first line.
      line_of: (record, its number) -> its line; sent to the workers.
      label: of the progress bar.
      workers: processes that share the work; 0: this process does it.

    Raises:
      ValueError: the folder holds no records, or is in use by another process.
      OSError: a file cannot be written; names it.
    """
    counts = {}
    load_manifest(folder)  # a folder without one stays untouched
    with locked_records(folder):
        manifest = load_manifest(folder)
        for split, entry in manifest["splits"].items():
            rows = range(entry["records"])
            if not rows:
                continue
            line = functools.partial(_line_of_row, line_of, folder, split, manifest["hash"])
            with whole_file(path_of(folder, split)) as file, WorkerPool(workers, chunk_size=32) as run:
                lines = tqdm(
                    run(line, rows), f"{label} of {split}", total=len(rows), unit="record", disable=not progress
                )
                # Without name and time in the head, equal content is equal bytes.
                with gzip.GzipFile("", "wb", fileobj=file, mtime=0) as packed:
                    packed.write(head_of(manifest) + b"\n")
                    packed.writelines(one + b"\n" for one in lines)
            counts[split] = len(rows)
    return counts


def _line_of_row(
    line_of: Callable[[SceneRecord, int], bytes], folder: Path, split: str, records_hash: str, row: int
) -> bytes:
    return line_of(records.read_record(_open_records(folder, split, records_hash), row), row)


@functools.lru_cache(1)
def _open_records(folder: Path, split: str, records_hash: str):
    """The records of a split, opened once per process; the hash distinguishes records that were built again."""
    del records_hash
    return records.open_records(folder, split)


def read_lines(path: Path, remedy: str) -> Iterator[bytes]:
    """The lines of a packed file; at least one, if it is empty an empty one. Their length is limited.

    Args:
      remedy: command that writes the file, for the end of a message.

    Raises:
      ValueError: the file is damaged, or a line is cut short or too long; names file and line.
    """
    number = 1
    with path.open("rb") as packed, gzip.GzipFile(fileobj=packed) as file:
        while True:
            try:
                line = file.readline(_MAX_LINE)
            except (OSError, EOFError, zlib.error) as error:
                raise ValueError(f"{path}, line {number}: the file is damaged ({error}): {remedy} again") from error
            if line and not line.endswith(b"\n"):
                raise ValueError(f"{path}, line {number}: it is cut short, or longer than any line: {remedy} again")
            if not line and number > 1:
                return
            yield line
            number += 1
