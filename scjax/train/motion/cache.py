"""Logs as arrays that training reads: a folder with one file for each roll of each log, and the vocabulary."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from scjax.data.imports import find_format, import_log
from scjax.models.behavior.config import CLASSES, STEP, BehaviorConfig
from scjax.models.behavior.vocabulary import build_vocabulary
from scjax.scene import Log
from scjax.scene.document import parse_document
from scjax.scene.files import locked_folder, write_file, write_text
from scjax.train.motion.clearance_returns import clearance_returns
from scjax.train.motion.rolls import NO_NOISE, NOISE, Rolls, roll_tracks
from scjax.train.motion.tracks import LogTracks, tracks_of

_FORMAT = 1
_INDEX, _VOCABULARY = "motion.json", "vocabulary.npy"
_LIMIT_SCALE = 4  # stored speed limits are in steps of 0.25 m/s
_FAR = 500.0  # m; larger gaps are stored as this
_VALIDATION = 10  # every tenth place
_VOCABULARY_LOGS = 60
_CURE = "delete the folder: it is built again"


@dataclasses.dataclass(frozen=True)
class MotionCache:
    """Rolls of logs.

    Attributes:
      folder: where they are.
      vocabulary: of the motions.
      train, validation: names of the files; logs of one place are all in one of them.
      sha256: of the logs and the sizes that shape the files.
    """

    folder: Path
    vocabulary: Float[np.ndarray, "C V 3"]
    train: tuple[str, ...]
    validation: tuple[str, ...]
    sha256: str

    def read(self, name: str) -> dict[str, np.ndarray]:
        """The arrays of a roll."""
        try:
            with np.load(self.folder / name) as arrays:
                return dict(arrays)
        except (OSError, ValueError) as error:
            raise ValueError(f"{self.folder / name} cannot be read ({error}): {_CURE}") from error


def open_cache(logs: str | Path, folder: str | Path, config: BehaviorConfig, rolls: int, seed: int) -> MotionCache:
    """The cache of a folder of logs; it is built first if it is not there.

    Args:
      logs: folder of files of any format with motion that ``scjax.data.imports`` reads.
      folder: of the cache.
      rolls: of each log; the first without noise.

    Raises:
      ValueError: there is no log, or the cache is of other logs or sizes.
    """
    files, folder = _log_files(Path(logs)), Path(folder)
    sha256 = _hash(files, config, rolls, seed)
    if not (folder / _INDEX).is_file():
        folder.mkdir(parents=True, exist_ok=True)
        with locked_folder(folder):
            _build(files, folder, config, rolls, seed, sha256)
    index = parse_document((folder / _INDEX).read_bytes(), dict[str, Any], folder / _INDEX, _CURE)
    if index.get("sha256") != sha256:
        raise ValueError(f"{folder} is of other logs, sizes or rolls: choose another --config.cache, or delete it")
    vocabulary = np.load(folder / _VOCABULARY)
    return MotionCache(folder, vocabulary, tuple(index["train"]), tuple(index["validation"]), sha256)


def _log_files(folder: Path) -> list[Path]:
    names = (".npz", ".json", ".json.gz", ".pkl", ".parquet", ".xml")
    files = sorted(path for path in folder.rglob("*") if path.name.endswith(names)) if folder.is_dir() else []
    if not files:
        raise ValueError(f"{folder} has no logs: write some with scjax data logs, or give --config.logs=FOLDER")
    return files


def _hash(files: Sequence[Path], config: BehaviorConfig, rolls: int, seed: int) -> str:
    parts: list[Any] = [_FORMAT, config.history, config.motions, config.returns, rolls, seed]
    parts += [[path.name, path.stat().st_size] for path in files]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _read_log(path: Path) -> Log | None:
    """The log of a file, or None where it holds something else."""
    try:
        return import_log(path) if find_format(path) != "map" else None
    except ValueError as error:
        print(f"left out: {error}", file=sys.stderr)
        return None


def _build(files: list[Path], folder: Path, config: BehaviorConfig, rolls: int, seed: int, sha256: str) -> None:
    """Writes all files; the index comes last."""
    vocabulary = _vocabulary(files, config, seed)
    write_file(folder / _VOCABULARY, lambda file: np.save(file, vocabulary))
    names: dict[str, list[str]] = {"train": [], "validation": []}
    for number, path in enumerate(files):
        log = _read_log(path)
        if log is None:
            continue
        try:
            tracks = tracks_of(log, np.random.default_rng([seed, number]))
        except ValueError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        place = log.metadata.location_cluster or log.metadata.scene_id or path.name
        is_held = int(hashlib.sha256(place.encode()).hexdigest(), 16) % _VALIDATION == 0
        for roll in range(1 if is_held else rolls):
            key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), number), roll)
            result = roll_tracks(key, tracks, vocabulary, config.history, NOISE if roll else NO_NOISE)
            arrays = _pack(tracks, result, config)
            name = f"{number:05d}-{roll}.npz"
            write_file(folder / name, functools.partial(_save, arrays))
            names["validation" if is_held else "train"].append(name)
        if number % 50 == 0:
            print(f"motion cache: {number} of {len(files)} logs", file=sys.stderr)
    if not names["train"]:
        raise ValueError("none of the logs can be used: see the lines above")
    write_text(folder / _INDEX, json.dumps({"sha256": sha256, **names}))


def _save(arrays: dict[str, np.ndarray], file: Any) -> None:
    np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]


def _vocabulary(files: list[Path], config: BehaviorConfig, seed: int) -> np.ndarray:
    """The vocabulary of each class, from some of the logs [C, V, 3]."""
    changes: list[list[np.ndarray]] = [[] for _ in range(CLASSES)]
    for path in files[:: max(len(files) // _VOCABULARY_LOGS, 1)]:
        log = _read_log(path)
        if log is None or log.num_steps < 7:
            continue
        stride = max(round(STEP / log.dt), 1)
        for kind in range(CLASSES):
            rows = log.object_types == kind
            for first in range(stride):
                changes[kind].append(_changes(log[first::stride], rows))
    rng = np.random.default_rng(seed)
    parts = [np.concatenate([np.zeros((0, 3)), *some]) for some in changes]
    return np.stack([build_vocabulary(part, kind, config.motions, rng) for kind, part in enumerate(parts)])


def _changes(log: Log, rows: np.ndarray) -> np.ndarray:
    """Changes of motion of some objects between two steps [n, 3]."""
    if log.num_steps < 3:
        return np.zeros((0, 3))
    d_x, d_y = np.diff(log.positions[rows, :, :2], axis=1).transpose(2, 0, 1)
    heading = log.headings[rows]
    cos, sin = np.cos(heading[:, :-1]), np.sin(heading[:, :-1])
    turn = np.angle(np.exp(1j * np.diff(heading, axis=1)))
    motions = np.stack([d_x * cos + d_y * sin, d_y * cos - d_x * sin, turn], -1)
    valid = log.valid[rows]
    both = valid[:, 2:] & valid[:, 1:-1] & valid[:, :-2]
    moves = np.hypot(motions[:, 1:, 0], motions[:, 1:, 1]) > 0.03
    return np.diff(motions, axis=1)[both & moves]


def _pack(tracks: LogTracks, rolls: Rolls, config: BehaviorConfig) -> dict[str, np.ndarray]:
    """Few bytes for each agent and step; ways are in the frame of the agent."""
    traffic = rolls.traffic
    x, y, heading, valid = (np.asarray(v) for v in (traffic.x, traffic.y, traffic.heading, traffic.valid))
    d_x, d_y = np.asarray(traffic.way_x) - x[..., None], np.asarray(traffic.way_y) - y[..., None]
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    trained = np.asarray(rolls.has_target) & ~tracks.is_parked[None]
    returns = clearance_returns(x, y, heading, valid, tracks.length, tracks.width, config.returns)
    return {
        "x": x, "y": y, "heading": heading, "valid": valid, "length": tracks.length, "width": tracks.width,
        "kind": tracks.kind.astype(np.int8), "motions": np.asarray(traffic.motions, np.float16),
        "base": np.asarray(traffic.motions)[:, :, 0], "fresh": np.asarray(rolls.fresh),
        "known": np.asarray(traffic.known), "target": np.asarray(rolls.target), "trained": trained,
        "way_ahead": (d_x * cos + d_y * sin).astype(np.float16),
        "way_left": (d_y * cos - d_x * sin).astype(np.float16),
        "limit": np.round(np.clip(_LIMIT_SCALE * np.asarray(traffic.limit), 0, 255)).astype(np.uint8),
        "inside": np.asarray(traffic.inside), "has_way": np.asarray(traffic.has_way),
        "signal": np.asarray(traffic.signal, np.int8),
        "signal_gap": np.minimum(traffic.signal_gap, _FAR).astype(np.float16),
        "end_gap": np.minimum(traffic.end_gap, _FAR).astype(np.float16), "returns": returns.astype(np.int8),
    }  # fmt: skip


def limits_of(stored: np.ndarray) -> np.ndarray:
    """Speed limits [m/s] from those in a file."""
    return stored.astype(np.float32) / _LIMIT_SCALE
