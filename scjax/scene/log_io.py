"""Logs in files: one compressed ``.npz`` each, exact."""

from __future__ import annotations

import dataclasses
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from scjax.scene.files import write_file
from scjax.scene.log import Log, LogMetadata, validate_log
from scjax.scene.map_lane import LaneNeighbor, MapLane

LOG_FORMAT, LOG_VERSION = "scjax-log", 1
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
    "lane_points": "f",
    "lane_offsets": "i",
}


def save_log(log: Log, path: str | Path) -> None:
    """Writes ``log`` exactly, to a temporary name first.

    The file holds the numeric fields as arrays, all lanes as one ragged array (``lane_points``, ``lane_offsets``), and
    everything else as JSON in ``header``.

    Raises:
      ValueError: if the log breaks an invariant (``validate_log``).
    """
    validate_log(log)
    lanes = [{key: value for key, value in vars(lane).items() if key != "points"} for lane in log.lanes]
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
    arrays: dict[str, Any] = {name: getattr(log, name) for name in _ARRAYS if not name.startswith("lane_")}
    arrays["lane_points"] = np.concatenate([np.zeros((0, 3)), *(lane.points for lane in log.lanes)])
    arrays["lane_offsets"] = np.cumsum([0, *(len(lane.points) for lane in log.lanes)])
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
    try:
        with path.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        header = json.loads(str(arrays.pop("header", "{}")))
    except FileNotFoundError:
        raise
    except (OSError, EOFError, ValueError, AttributeError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path} is no readable log ({error}): it may be cut short, write it again") from error
    if not isinstance(header, dict) or header.get("format") != LOG_FORMAT:
        raise ValueError(f"{path} is no log: write it with scjax.scene.save_log")
    if header.get("version") != LOG_VERSION:
        raise ValueError(f"{path} has format version {header.get('version')}, this scjax reads {LOG_VERSION}: update")
    if missing := sorted(set(_ARRAYS) - set(arrays)):
        raise ValueError(f"{path} lacks the arrays {missing}: write it with scjax.scene.save_log")
    for name, dtype_kind in _ARRAYS.items():
        if arrays[name].dtype.kind != dtype_kind:
            raise ValueError(f"{path}: {name} is {arrays[name].dtype}: write it with scjax.scene.save_log")
    try:
        return validate_log(_log_from(header, arrays))
    except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
        raise ValueError(f"{path} holds an invalid log: {error}") from error


def _log_from(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Log:
    offsets = arrays["lane_offsets"]
    points = np.split(arrays["lane_points"], offsets[1:-1]) if len(offsets) > 1 else []
    return Log(
        **{name: arrays[name] for name in _ARRAYS if not name.startswith("lane_")},
        object_ids=tuple(header["object_ids"]),
        signal_lane_ids=tuple(header["signal_lane_ids"]),
        ego_index=header["ego_index"],
        has_topology=header["has_topology"],
        lanes=tuple(_lane_from(fields, xyz) for fields, xyz in zip(header["lanes"], points, strict=True)),
        metadata=LogMetadata(**header["metadata"]),
    )


def _lane_from(fields: dict[str, Any], points: np.ndarray) -> MapLane:
    neighbors = {
        side: tuple(LaneNeighbor(*entry) for entry in fields[side]) for side in ("left_neighbors", "right_neighbors")
    }
    return MapLane(
        id=fields["id"],
        lane_type=fields["lane_type"],
        points=points,
        predecessors=tuple(fields["predecessors"]),
        successors=tuple(fields["successors"]),
        **neighbors,
    )
