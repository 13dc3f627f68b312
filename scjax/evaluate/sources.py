"""Where scenes come from: records, npz files, evaluation tiles, or rows of another source; read in parts, in any order.

A source is a small picklable object, so that any process can read any part of it, and no set of scenes has to be in
memory. ``open_source`` makes one from a text: "records:runs/records#val", "npz:runs/samples", "tiles:peer.npz#all".
"""

from __future__ import annotations

import functools
import hashlib
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from scjax.metrics.cluster_sums import group_of
from scjax.scene import Crop, Link, Scene, empty, unpadded
from scjax.scene.io import load_npz

BUCKET = (61, 100)  # agents and lanes of a scene at most; crops hold the nearest first


@runtime_checkable
class Source(Protocol):
    """Scenes by row.

    Attributes:
      clusters: the location of every scene; scenes of one cluster are never compared as if they were independent.
      ego: whether agent 0 of every scene is the ego.
      fingerprint: changes with the content.
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


class Records:
    """Centred tiles of a split of training records."""

    ego = True

    def __init__(self, folder: str, split: str):
        from scjax.data.build import SPLITS, load_manifest

        if split not in SPLITS:
            raise ValueError(f"records:{folder}#{split}: write one of the splits {', '.join(SPLITS)} behind the #")
        self.folder, self.split = folder, split
        manifest = load_manifest(folder)
        self.domains: list[str] = manifest["domains"]
        self.fingerprint = digest("records", manifest["hash"], split)

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

        return [f"{one.domain}/{one.cluster}" for one in map(records.decode_record, self._data)]

    def read(self, rows: Sequence[int]) -> list[Scene]:
        return [self.read_moved(int(row)) for row in rows]

    def read_moved(self, row: int, dx: float = 0.0, dy: float = 0.0, turn: float = 0.0) -> Scene:
        """One scene from a pose moved by dx, dy [m] and turn [rad]."""
        from scjax.data import records
        from scjax.data.loader import clip_counts

        record = records.decode_record(self._data[row])
        return clip_counts(records.sample_scene(record, Crop.CENTERED, dx, dy, turn), BUCKET)

    def __getstate__(self):
        return {name: value for name, value in vars(self).items() if name != "_data"}  # open files stay here


class Npz:
    """Scenes of scjax.scene.io.save_npz: one file, or all of a folder by name, each a scene or a batch."""

    def __init__(self, path: str, ego: bool = True):
        place = Path(path)
        self.files = sorted(place.glob("*.npz")) if place.is_dir() else [place]
        if not self.files or not self.files[0].is_file():
            raise ValueError(f"npz:{path}: there is no .npz file: write scenes with scjax.scene.io.save_npz")
        self.ego = ego
        self._rows = [(number, row) for number, file in enumerate(self.files) for row in _rows(file)]
        self.clusters = [group_of(k) for k in range(len(self._rows))]
        self.fingerprint = digest("npz", *(hashlib.sha256(file.read_bytes()).hexdigest() for file in self.files))

    def read(self, rows: Sequence[int]) -> list[Scene]:
        chosen = [self._rows[int(k)] for k in rows]
        held = {number: load_npz(self.files[number]) for number in dict.fromkeys(number for number, _ in chosen)}
        return [unpadded(held[number] if row is None else held[number][row]) for number, row in chosen]


class EvaluationTiles:
    """Tiles of the ragged format of the project's evaluation sets; ``variant`` of the agents: main or all."""

    def __init__(self, path: str, variant: str = "main"):
        self.path, self.variant = Path(path), variant
        if not self.path.is_file():
            raise ValueError(f"tiles:{path}: there is no such file")
        if variant not in ("main", "all"):
            raise ValueError(f"tiles:{path}#{variant}: write main or all behind the #")
        try:
            names = self._arrays["cluster_name"][self._arrays["tile_cluster"]]
            self.ego = bool((self._arrays["tile_object"] >= 0).all())
        except KeyError as error:
            raise ValueError(f"tiles:{path} lacks the array {error}: it holds no evaluation tiles") from error
        self.clusters = [str(name) for name in names]
        self.fingerprint = digest("tiles", hashlib.sha256(self.path.read_bytes()).hexdigest(), variant)

    @functools.cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        with self.path.open("rb") as file, np.load(file) as data:
            return dict(data)

    def read(self, rows: Sequence[int]) -> list[Scene]:
        return [tile_scene(self._arrays, int(k), self.variant) for k in rows]

    def __getstate__(self):
        return {name: value for name, value in vars(self).items() if name != "_arrays"}


class Chosen:
    """Rows of another source, in any order and any number of times."""

    def __init__(self, source: Source, rows: Sequence[int] | np.ndarray):
        self.source, self.rows, self.ego = source, np.asarray(rows, int), source.ego
        self.fingerprint = digest("chosen", source.fingerprint, row_text(self.rows))

    @property
    def clusters(self) -> list[str]:
        every = self.source.clusters
        return [every[row] for row in self.rows]

    def read(self, rows: Sequence[int]) -> list[Scene]:
        return self.source.read([int(self.rows[int(k)]) for k in rows])


def open_source(text: str) -> Source:
    """A source from "KIND:PATH#PART"; kinds: records (part: split), npz, tiles (part: main or all).

    Scenes of npz files hold the ego unless the part is "no-ego".

    Raises:
      ValueError: another form, or no such files.
    """
    kind, _, rest = text.partition(":")
    path, _, part = rest.partition("#")
    if kind == "records" and path:
        return Records(path, part or "val")
    if kind == "npz" and path and part in ("", "no-ego"):
        return Npz(path, ego=part != "no-ego")
    if kind == "tiles" and path:
        return EvaluationTiles(path, part or "main")
    raise ValueError(
        f"{text!r} names no scenes: write records:FOLDER#val, npz:FOLDER, npz:FOLDER#no-ego or tiles:FILE.npz#main"
    )


def digest(*parts: str) -> str:
    """A short hash of texts."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def row_text(rows: Sequence[int] | np.ndarray) -> str:
    """Row numbers as a text to be hashed."""
    return np.asarray(rows, int).tobytes().hex()


def tile_scene(arrays: dict[str, np.ndarray], tile: int, variant: str) -> Scene:
    """One tile as a scene; heights that are unknown hold 1.5 m and are flagged."""
    rows, lanes, edges = (np.arange(*arrays[f"{kind}_offsets"][tile : tile + 2]) for kind in ("agent", "lane", "edge"))
    rows = rows[arrays[f"agent_{variant}"][rows]]
    points = np.concatenate([arrays["lanes_xy"][lanes], arrays["lanes_z"][lanes][..., None]], -1)
    made = empty(len(rows), len(lanes))
    before, after = arrays["edges"][edges].T.astype(int)
    links = np.diag(np.full(len(lanes), Link.SELF, np.int32))
    links[after, before] = Link.SUCCESSOR
    links[before, after] = Link.PREDECESSOR
    return made.replace(
        links=links,
        agents=np.nan_to_num(arrays["agents"][rows], nan=1.5),
        agent_types=arrays["agent_type"][rows].astype(np.int32),
        agent_mask=np.ones(len(rows), bool),
        agent_known=~np.isnan(arrays["agents"][rows]),
        lanes=np.nan_to_num(points),
        lane_mask=np.ones(len(lanes), bool),
        lane_known=~np.isnan(points).any(1),
    )


def _rows(file: Path) -> Sequence[int | None]:
    """Row numbers of a batch, None for a single scene; reads one small array where the file is whole."""
    try:
        with file.open("rb") as handle, np.load(handle, allow_pickle=False) as data:
            shape = data["domain"].shape
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile):
        shape = load_npz(file).batch_shape  # says what is wrong
    if len(shape) > 1:
        raise ValueError(f"{file} holds scenes of batch shape {shape}: flatten them to one axis")
    return range(shape[0]) if shape else [None]
