"""Measured attributes of records: worked out once, then read by the training on attributes.

``attributes-<split>.jsonl.gz`` holds a head and one line per record, in record order: the attributes of its centered
window. ``attributes-forward-<split>.jsonl.gz`` holds those of its window ahead of the ego.
"""

from __future__ import annotations

import functools
import itertools
from pathlib import Path
from typing import Any

import msgspec

from scjax.data.manifest import load_manifest
from scjax.data.packed_lines import read_lines, write_lines
from scjax.data.ranges import check_workers
from scjax.data.records import SceneRecord, sample_scene
from scjax.data.shards import stamp_file
from scjax.language.attributes.table import ATTRIBUTES, check_measurements, measure_attributes
from scjax.scene import Crop
from scjax.scene.document import parse_document

FORMAT = 1


class MeasuredRecords:
    """The measured attributes of one split.

    Attributes:
      sha256: of the file.

    Raises:
      ValueError: there are none, they belong to other records or another table of attributes, or the file is damaged.
    """

    def __init__(self, folder: str | Path, split: str, crop: Crop = Crop.CENTERED):
        ahead = " --forward" if crop == Crop.FORWARD else ""
        self._path, remedy = measurements_path(Path(folder), split, crop), f"run scjax data attributes {folder}{ahead}"
        if not self._path.is_file():
            raise ValueError(f"{self._path} is not there: {remedy}")
        manifest, self._cure = load_manifest(folder), f"{remedy} again"
        expected = manifest["splits"].get(split, {"records": 0})["records"]
        head, *self._lines = itertools.islice(read_lines(self._path, remedy), expected + 2)
        if parse_document(head, _Head, f"{self._path}, line 1", self._cure) != _head(manifest):
            raise ValueError(f"{self._path} was written for other records or attributes: {self._cure}")
        if len(self._lines) != expected:
            more = "more" if len(self._lines) > expected else "fewer"
            raise ValueError(f"{self._path} has {more} lines than there are records, {expected}: {self._cure}")
        self.sha256 = stamp_file(self._path).sha256

    def __len__(self) -> int:
        """Number of records."""
        return len(self._lines)

    def __getitem__(self, record: int) -> dict[str, Any]:
        """The measurements of a record, as ``measure_attributes`` gives them.

        Raises:
          ValueError: the line is damaged.
        """
        name = f"{self._path}, line {record + 2}"
        values = parse_document(self._lines[record], dict[str, Any], name, self._cure)
        try:
            return check_measurements(values)
        except ValueError as error:
            raise ValueError(f"{name}: {error}: {self._cure}") from error


def measure_records(
    folder: str | Path, *, crop: Crop = Crop.CENTERED, workers: int = 0, progress: bool = True
) -> dict[str, int]:
    """Measures the attributes of every record of a folder; returns the number of records of each split.

    Args:
      crop: the windows that are measured, centered or ahead of the ego.
      workers: processes that share the work; 0: this process does it.

    Raises:
      ValueError: the folder holds no records, is in use by another process, or an argument is out of its range.
      OSError: a file cannot be written; names it.
    """
    check_workers(workers)
    return write_lines(
        Path(folder),
        functools.partial(measurements_path, crop=crop),
        lambda manifest: msgspec.json.encode(_head(manifest)),
        functools.partial(_measured_line, crop=crop),
        label="attributes",
        workers=workers,
        progress=progress,
    )


def measurements_path(folder: Path, split: str, crop: Crop = Crop.CENTERED) -> Path:
    """The file of a split's measurements."""
    name = "attributes-forward" if crop == Crop.FORWARD else "attributes"
    return folder / f"{name}-{split}.jsonl.gz"


class _Head(msgspec.Struct):
    """The first line: format, hash of the records, names of the attributes."""

    format: Any = None
    records: Any = None
    attributes: Any = None


def _head(manifest: dict[str, Any]) -> _Head:
    return _Head(FORMAT, manifest["hash"], list(ATTRIBUTES))


def _measured_line(record: SceneRecord, row: int, *, crop: Crop) -> bytes:
    del row
    return msgspec.json.encode(measure_attributes(sample_scene(record, crop)))
