"""scjax's own files: a log as .npz, exactly, and as a recording in JSON."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np

from scjax.data.readers.scene_json import SCHEMA
from scjax.export.base import Export, Losses
from scjax.scene import NO_EGO, OTHER_OBJECT, AgentType, LaneNeighbor, Log, Signal, save_log
from scjax.scene.files import write_file

_TYPES = {kind.value: kind.name.lower() for kind in AgentType} | {OTHER_OBJECT: "other"}


def write_npz(log: Log, path: Path, losses: Losses) -> tuple[Path, ...]:
    """Writes ``log`` exactly (``scjax.load_log``); nothing is lost."""
    save_log(log, path)
    return (path,)


def write_recording(log: Log, path: Path, losses: Losses) -> tuple[Path, ...]:
    """Writes ``log`` as a recording (docs/scene-json.md), compressed if the name ends in .gz."""
    losses["names of the source, notes and counts of the reader"] += bool(
        log.metadata.notes or log.metadata.unknown_words
    )
    data = json.dumps(recording_content(log), allow_nan=False).encode()
    write_file(path, lambda file: file.write(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data))
    return (path,)


def recording_content(log: Log) -> dict[str, Any]:
    """A log as the JSON values of a recording."""
    lights = zip(log.signal_lane_ids, log.signal_states, log.signal_positions, strict=True)
    return {
        "schema": SCHEMA,
        "dataset": log.metadata.domain,
        "scene_id": log.metadata.scene_id,
        "location_cluster": log.metadata.location_cluster,
        "variant": log.metadata.variant,
        "timestamps": log.timestamps.tolist(),
        "has": {"topology": "given" if log.has_topology else "infer"},
        "sdc_index": None if log.ego_index == NO_EGO else log.ego_index,
        "objects": [_object(log, row) for row in range(log.num_objects)],
        "map": [_lane(lane) for lane in log.lanes],
        "tl_states": {
            lane: {
                "state": [Signal(state).name.lower() for state in states.tolist()],
                **dict(zip("xyz", _values(place), strict=True)),
            }
            for lane, states, place in lights
        },
    }


def _values(array: np.ndarray) -> list[float | None]:
    """Numbers, null where they are not known."""
    return [value if np.isfinite(value) else None for value in array.tolist()]


def _object(log: Log, row: int) -> dict[str, Any]:
    size = _values(log.sizes[row])
    columns = {
        **dict(zip("xyz", np.where(log.valid[row, :, None], log.positions[row], 0.0).T, strict=True)),
        "heading": np.where(log.valid[row], log.headings[row], 0.0),
        "vx": np.where(log.valid[row], log.velocities[row, :, 0], 0.0),
        "vy": np.where(log.valid[row], log.velocities[row, :, 1], 0.0),
    }
    return {
        "id": log.object_ids[row],
        "type": _TYPES[int(log.object_types[row])],
        **dict(zip(("length", "width", "height"), size, strict=True)),
        "valid": log.valid[row].tolist(),
        **{name: _values(values) for name, values in columns.items()},
    }


def _lane(lane: Any) -> dict[str, Any]:
    x, y, z = (_values(column) for column in lane.points.T)
    neighbors: dict[str, tuple[LaneNeighbor, ...]] = {
        "left_neighbors": lane.left_neighbors,
        "right_neighbors": lane.right_neighbors,
    }
    return {
        "type": "lane",
        "id": lane.id,
        "subtype": lane.lane_type,
        "x": x,
        "y": y,
        "z": None if None in z else z,
        "predecessors": list(lane.predecessors),
        "successors": list(lane.successors),
        **{name: [list(entry) for entry in entries] for name, entries in neighbors.items()},
    }


NPZ_EXPORT = Export("scjax log", ".npz", "scjax.load_log", write_npz)
RECORDING_EXPORT = Export("scjax recording", ".json.gz", "scjax.import_log, scjax data build", write_recording)
