"""Training records: the local map within 80 m of one ego pose, as safetensors bytes in ArrayRecord shards.

A record is cut once and cropped on every access, so one record yields any crop and pose jitter.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy
from array_record.python import array_record_data_source, array_record_module  # pyright: ignore

from scjax.data.crop import WINDOWS, crop_scene
from scjax.data.lane_graph import LaneGraph, SegmentIndex
from scjax.data.local_map import RADIUS, LocalMap, cut_local_map
from scjax.data.tiles import Pose
from scjax.scene import Crop, Log, Scene

RECORD_FORMAT = 1
_KNOWN_BITS = 1 << np.arange(9, dtype=np.uint16)
_BOOLEANS = ("off_road", "lane_z_known")  # stored as uint8
_STORED_NAMES = {  # field -> name in a record; all others are stored under their own
    "successors": "edges",
    "neighbors": "beside",
    "overlap_spans": "spans",
    "object_index": "object",
}


@dataclasses.dataclass(frozen=True)
class SceneRecord:
    """A local map and where it comes from.

    Attributes:
      domain: index into the manifest's list of data sets.
      cluster: location; see ``LogMetadata.location_cluster``.
      scene_id: name of the log.
      step, object_index: the ego's pose, as in ``Pose``.
      is_recorder: whether the ego is the recording car.
    """

    local_map: LocalMap
    domain: int
    cluster: str
    scene_id: str
    step: int
    object_index: int
    is_recorder: bool


def make_record(
    log: Log, graph: LaneGraph, index: SegmentIndex, pose: Pose, domain: int
) -> tuple[SceneRecord, dict[str, int]]:
    """The record around ``pose``, and the counts of cleaned agent values.

    Args:
      graph: simplified lanes of ``log`` (``simplify_graph``).
      index: search structure of the lanes before they were simplified.
      domain: index of the log's data set in the manifest's list.
    """
    local_map, counts = cut_local_map(log, graph, index, pose)
    metadata = log.metadata
    origin = (domain, metadata.location_cluster, metadata.scene_id, pose.step, pose.object_index, pose.is_recorder)
    return SceneRecord(local_map, *origin), counts


def encode_record(record: SceneRecord) -> bytes:
    """``record`` as safetensors bytes."""
    arrays = {_stored_name(field.name): getattr(record.local_map, field.name) for field in dataclasses.fields(LocalMap)}
    arrays["agent_known"] = (arrays["agent_known"] @ _KNOWN_BITS).astype(np.uint16)
    for name in _BOOLEANS:
        arrays[name] = arrays[name].astype(np.uint8)
    names = [field.name for field in dataclasses.fields(SceneRecord) if field.name != "local_map"]
    origin = {_stored_name(name): getattr(record, name) for name in names}
    # One key, since safetensors writes several in random order and equal records shall be equal bytes.
    metadata = {"record": json.dumps({"format": RECORD_FORMAT, **origin})}
    return safetensors.numpy.save({k: np.ascontiguousarray(v) for k, v in arrays.items()}, metadata)


def _stored_name(field: str) -> str:
    return _STORED_NAMES.get(field, field)


def _field_name(stored: str) -> str:
    return next((field for field, name in _STORED_NAMES.items() if name == stored), stored)


_DTYPES = {
    "F32": np.float32,
    "F64": np.float64,
    "I64": np.int64,
    "I32": np.int32,
    "I16": np.int16,
    "U16": np.uint16,
    "U8": np.uint8,
}


def decode_record(data: bytes) -> SceneRecord:
    """The record in safetensors bytes, its arrays read-only views of ``data``.

    Raises:
      ValueError: if the bytes are no record, or one of another format.
    """
    try:
        size = int.from_bytes(data[:8], "little")
        header = json.loads(data[8 : 8 + size])
        origin = json.loads(header.pop("__metadata__")["record"])
        version = origin.pop("format")
        if version == RECORD_FORMAT:
            arrays = {name: _view(data, 8 + size, entry) for name, entry in header.items()}
            arrays["agent_known"] = (arrays["agent_known"][:, None] & _KNOWN_BITS) != 0
            for name in _BOOLEANS:
                arrays[name] = arrays[name].view(bool)
            local_map = LocalMap(**{_field_name(name): array for name, array in arrays.items()})
            return SceneRecord(local_map, **{_field_name(name): value for name, value in origin.items()})
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"data: {len(data)} bytes, but no scene record ({error}): build the records again") from error
    raise ValueError(f"data: record format {version}, not {RECORD_FORMAT}: build the records again")


def _view(data: bytes, base: int, entry: dict[str, Any]) -> np.ndarray:
    start, end = entry["data_offsets"]
    dtype = np.dtype(_DTYPES[entry["dtype"]])
    return np.frombuffer(data, dtype, (end - start) // dtype.itemsize, base + start).reshape(entry["shape"])


def sample_scene(
    record: SceneRecord,
    crop: Crop = Crop.CENTERED,
    dx: float = 0.0,
    dy: float = 0.0,
    dyaw: float = 0.0,
    *,
    off_road: bool = False,
) -> Scene:
    """The unpadded NumPy scene of ``record`` in ``crop``, at a pose moved by dx, dy [m] and dyaw [rad].

    At zero offset and CENTERED this is the evaluation tile. See ``crop_scene`` for the rules.

    Raises:
      ValueError: if the moved window reaches beyond the 80 m that a record holds.
    """
    x_min, x_max, y_min, y_max = WINDOWS[crop]
    reach = np.hypot(max(-x_min, x_max), max(-y_min, y_max)) + np.hypot(dx, dy)
    if reach > RADIUS:
        raise ValueError(
            f"dx, dy = {dx:.1f}, {dy:.1f} m: the {crop.name} window then reaches {reach:.1f} m from the recorded "
            f"pose, but records end at {RADIUS:.0f} m: choose smaller offsets"
        )
    return crop_scene(record.local_map, crop, dx=dx, dy=dy, dyaw=dyaw, domain=record.domain, off_road=off_road)


def write_shard(path: Path, records: Iterable[bytes]) -> int:
    """Writes an ArrayRecord shard, complete or not at all, and returns its number of records."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    writer = array_record_module.ArrayRecordWriter(str(temporary), "group_size:1,zstd:3")
    count = 0
    try:
        for data in records:
            writer.write(data)
            count += 1
        writer.close()
        os.replace(temporary, path)
    finally:
        if writer.is_open():
            writer.close()
        temporary.unlink(missing_ok=True)
    return count


def shard_paths(folder: str | Path, split: str) -> list[Path]:
    """The shards of a split in order.

    Raises:
      ValueError: if there are none, or some of them are missing.
    """
    paths = sorted(Path(folder).glob(f"{split}-?????-of-?????.arrayrecord"))
    if not paths:
        raise ValueError(f"{folder}: no {split} shards there: run `python -m scjax.data build SOURCE {folder}` first")
    total = int(paths[0].name.split("-of-")[1][:5])
    expected = [f"{split}-{i:05d}-of-{total:05d}.arrayrecord" for i in range(total)]
    if [path.name for path in paths] != expected:
        raise ValueError(f"{folder}: {split} shards are not the complete set of {total}: finish or repeat the build")
    return paths


def open_records(folder: str | Path, split: str) -> Any:
    """The encoded records (bytes, for ``decode_record``) of a split, in file order: len(), [index] and iteration.

    Raises:
      ValueError: as ``shard_paths``.
    """
    return array_record_data_source.ArrayRecordDataSource([str(path) for path in shard_paths(folder, split)])
