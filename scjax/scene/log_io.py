"""Logs in files: one compressed ``.npz`` each, exact."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from scjax.scene.document import parse_document
from scjax.scene.files import write_file
from scjax.scene.lane_io import LANE_ARRAYS, LaneHeader, pack_lanes, unpack_lanes
from scjax.scene.log import Log, LogMetadata, validate_log
from scjax.scene.npz import read_npz

LOG_FORMAT, LOG_VERSION = "scjax-log", 1
_CURE = "write it with scjax.scene.save_log"
_ARRAYS = {  # name -> kind of its dtype
    "timestamps": "f",
    "object_types": "i",
    "valid": "b",
    "positions": "f",
    "headings": "f",
    "velocities": "f",
    "sizes": "f",
    "signal_states": "i",
    "signal_positions": "f",
    **LANE_ARRAYS,
}


class LogVersion(Struct):
    """What is read first of a header."""

    format: Any = None
    version: Any = None


class LogHeader(Struct):
    """All of a log that is not numbers."""

    object_ids: tuple[str, ...]
    signal_lane_ids: tuple[str, ...]
    ego_index: int
    has_topology: bool
    metadata: LogMetadata
    lanes: list[LaneHeader]


def save_log(log: Log, path: str | Path) -> None:
    """Writes ``log`` exactly, to a temporary name first.

    The file holds the numeric fields as arrays, all lanes as one ragged array (``lane_points``, ``lane_offsets``), and
    everything else as JSON in ``header``.

    Raises:
      ValueError: if the log breaks an invariant (``validate_log``).
    """
    validate_log(log)
    lanes, lane_arrays = pack_lanes(log.lanes)
    header = {
        "format": LOG_FORMAT,
        "version": LOG_VERSION,
        "object_ids": log.object_ids,
        "signal_lane_ids": log.signal_lane_ids,
        "ego_index": log.ego_index,
        "has_topology": log.has_topology,
        "metadata": dataclasses.asdict(log.metadata),
        "lanes": lanes,
    }
    arrays: dict[str, Any] = {name: getattr(log, name) for name in _ARRAYS if name not in LANE_ARRAYS} | lane_arrays
    write_file(
        Path(path), lambda file: np.savez_compressed(file, allow_pickle=False, header=json.dumps(header), **arrays)
    )


def load_log(path: str | Path) -> Log:
    """Reads what ``save_log`` wrote.

    Raises:
      FileNotFoundError: if there is no such file.
      ValueError: on a damaged file, another version, missing arrays or an invalid log; names the file.
    """
    path = Path(path)
    arrays = read_npz(path, {"header": "U", **_ARRAYS}, _CURE, optional=frozenset({"header", *_ARRAYS}))
    text = str(arrays.pop("header", "{}"))
    version = parse_document(text, LogVersion, f"{path}, header", _CURE)
    if version.format != LOG_FORMAT:
        raise ValueError(f"{path} is no log: {_CURE}")
    if version.version != LOG_VERSION:
        raise ValueError(f"{path} has format version {version.version!r}, this scjax reads {LOG_VERSION}: update")
    if missing := sorted(set(_ARRAYS) - set(arrays)):
        raise ValueError(f"{path} lacks the arrays {missing}: {_CURE}")
    header = parse_document(text, LogHeader, f"{path}, header", _CURE)
    try:
        return validate_log(_log_from(header, arrays))
    except ValueError as error:
        raise ValueError(f"{path} holds an invalid log: {error}") from error


def _log_from(header: LogHeader, arrays: dict[str, np.ndarray]) -> Log:
    return Log(
        **{name: arrays[name] for name in _ARRAYS if name not in LANE_ARRAYS},
        object_ids=header.object_ids,
        signal_lane_ids=header.signal_lane_ids,
        ego_index=header.ego_index,
        has_topology=header.has_topology,
        lanes=unpack_lanes(header.lanes, arrays),
        metadata=header.metadata,
    )
