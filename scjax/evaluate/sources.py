"""Sources of scenes: records, npz files, evaluation tiles, or rows of another source; any row can be read on its own.

A source is a small picklable object: any process reads any part of it, and no set of scenes is in memory as a whole.
``open_source`` makes one from text: "records:runs/records#val", "npz:runs/samples", "tiles:peer.npz#all".
"""

from __future__ import annotations

import functools
import hashlib
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from scjax.evaluate.eval_tiles import EvaluationTiles
from scjax.evaluate.hashing import content_hash, row_text
from scjax.metrics.cluster_sums import group_of
from scjax.scene import Crop, Scene, unpadded
from scjax.scene.io import load_npz

LARGEST_COUNTS = (61, 100)  # agents and lanes of a scene at most; crops list the nearest first


@runtime_checkable
class SceneSource(Protocol):
    """Scenes by row.

    Attributes:
      clusters: location of every scene; scenes of one cluster are not independent.
      ego: whether agent 0 of every scene is the ego.
      fingerprint: a hash of the content.
    """

    @property
    def clusters(self) -> list[str]: ...

    @property
    def ego(self) -> bool: ...

    @property
    def fingerprint(self) -> str: ...

    def read(self, rows: Sequence[int]) -> list[Scene]:
        """Single NumPy scenes without padding."""
        ...


class RecordScenes:
    """Centered tiles of one split of training records."""

    ego = True

    def __init__(self, folder: str, split: str):
        from scjax.data.build import SPLITS, load_manifest

        if split not in SPLITS:
            raise ValueError(f"records:{folder}#{split}: write one of the splits {', '.join(SPLITS)} behind the #")
        self.folder, self.split = folder, split
        manifest = load_manifest(folder)
        self.domains: list[str] = manifest["domains"]
        self.fingerprint = content_hash("records", manifest["hash"], split)

    @functools.cached_property
    def _data(self):
        from scjax.data import records

        return records.open_records(self.folder, self.split)

    @property
    def clusters(self) -> list[str]:
        return self._clusters

    @functools.cached_property
    def _clusters(self) -> list[str]:
        from scjax.data import records

        rows = (records.read_record(self._data, row) for row in range(len(self._data)))
        return [f"{record.domain}/{record.cluster}" for record in rows]

    def read(self, rows: Sequence[int]) -> list[Scene]:
        return [self.read_moved(int(row)) for row in rows]

    def read_moved(self, row: int, dx: float = 0.0, dy: float = 0.0, turn: float = 0.0) -> Scene:
        """One scene in the frame of an ego pose moved by dx, dy [m] and turn [rad]."""
        from scjax.data import records
        from scjax.data.loader import clip_counts

        record = records.read_record(self._data, row)
        return clip_counts(records.sample_scene(record, Crop.CENTERED, dx, dy, turn), LARGEST_COUNTS)

    def __getstate__(self):
        return {name: value for name, value in vars(self).items() if name != "_data"}  # open files are not pickled


class NpzScenes:
    """npz files of scjax.scene.io.save_npz: one file, or all of a folder in order of names; each a scene or a batch."""

    def __init__(self, path: str, ego: bool = True):
        place = Path(path)
        self.files = sorted(place.glob("*.npz")) if place.is_dir() else [place]
        if not self.files or not self.files[0].is_file():
            raise ValueError(f"npz:{path}: there is no .npz file: write scenes with scjax.scene.io.save_npz")
        self.ego = ego
        self._rows = [(number, row) for number, file in enumerate(self.files) for row in _rows(file)]
        self.clusters = [group_of(k) for k in range(len(self._rows))]
        self.fingerprint = content_hash("npz", *(hashlib.sha256(file.read_bytes()).hexdigest() for file in self.files))

    def read(self, rows: Sequence[int]) -> list[Scene]:
        places = [self._rows[int(k)] for k in rows]
        files = {number: load_npz(self.files[number]) for number in dict.fromkeys(number for number, _ in places)}
        return [unpadded(files[number] if row is None else files[number][row]) for number, row in places]


class ChosenRows:
    """Rows of another source, in any order, with repetitions."""

    def __init__(self, source: SceneSource, rows: Sequence[int] | np.ndarray):
        self.source, self.rows, self.ego = source, np.asarray(rows, int), source.ego
        self.fingerprint = content_hash("chosen", source.fingerprint, row_text(self.rows))

    @property
    def clusters(self) -> list[str]:
        every = self.source.clusters
        return [every[row] for row in self.rows]

    def read(self, rows: Sequence[int]) -> list[Scene]:
        return self.source.read([int(self.rows[int(k)]) for k in rows])


def open_source(text: str) -> SceneSource:
    """A source from "FORMAT:PATH#PART".

    Formats: records (part: the split), npz (part "no-ego": agent 0 is no ego), tiles (part: main or all agents).

    Raises:
      ValueError: the text has another form, or the files are missing.
    """
    file_format, _, rest = text.partition(":")
    path, _, part = rest.partition("#")
    if file_format == "records" and path:
        return RecordScenes(path, part or "val")
    if file_format == "npz" and path and part in ("", "no-ego"):
        return NpzScenes(path, ego=part != "no-ego")
    if file_format == "tiles" and path:
        return EvaluationTiles(path, part or "main")
    raise ValueError(
        f"{text!r} names no scenes: write records:FOLDER#val, npz:FOLDER, npz:FOLDER#no-ego or tiles:FILE.npz#main"
    )


def _rows(file: Path) -> Sequence[int | None]:
    """Row numbers of a batch; [None] for a single scene. Reads only one small array of an intact file."""
    try:
        with file.open("rb") as handle, np.load(handle, allow_pickle=False) as data:
            shape = data["domain"].shape
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile):
        shape = load_npz(file).batch_shape  # raises an error that names the fault
    if len(shape) > 1:
        raise ValueError(f"{file} holds scenes of batch shape {shape}: flatten them to one axis")
    return range(shape[0]) if shape else [None]
