"""Training records: the local map within 80 m of one ego pose, as safetensors bytes in ArrayRecord shards.

A record is cut once and cropped on every access, so one record yields any crop and pose jitter.
"""

from __future__ import annotations

import dataclasses
import json
from typing import SupportsIndex

import numpy as np
import safetensors.numpy

from scjax.data.crop import WINDOWS, crop_scene
from scjax.data.lane_graph import LaneGraph, SegmentIndex
from scjax.data.local_map import RADIUS, LocalMap, cut_local_map
from scjax.data.record_checks import NUM_KNOWN, RECORD_FORMAT, find_fault, parse_record
from scjax.data.shards import RecordShards
from scjax.data.shards import open_records as open_records  # callers find all about records here
from scjax.data.shards import write_shard as write_shard
from scjax.data.tiles import Pose
from scjax.scene import Crop, Log, Scene

_KNOWN_BITS = 1 << np.arange(NUM_KNOWN, dtype=np.uint16)
_BOOLEANS = ("off_road", "lane_z_known")  # stored as uint8
_ARRAYS = {  # field of LocalMap -> name in a record
    field.name: {"successors": "edges", "neighbors": "beside", "overlap_spans": "spans"}.get(field.name, field.name)
    for field in dataclasses.fields(LocalMap)
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
    """``record`` as safetensors bytes.

    Raises:
      ValueError: its values contradict each other, so that ``decode_record`` would refuse them.
    """
    arrays = {name: getattr(record.local_map, field) for field, name in _ARRAYS.items()}
    arrays["agent_known"] = (arrays["agent_known"] @ _KNOWN_BITS).astype(np.uint16)
    for name in _BOOLEANS:
        arrays[name] = arrays[name].astype(np.uint8)
    if fault := find_fault(arrays):
        raise ValueError(f"{record.scene_id}, step {record.step}: no record can be made: {fault}")
    origin = {
        "format": RECORD_FORMAT,
        "domain": record.domain,
        "cluster": record.cluster,
        "scene_id": record.scene_id,
        "step": record.step,
        "object": record.object_index,
        "is_recorder": record.is_recorder,
    }
    # One key, since safetensors writes several in random order and equal records shall be equal bytes.
    metadata = {"record": json.dumps(origin)}
    return safetensors.numpy.save({k: np.ascontiguousarray(v) for k, v in arrays.items()}, metadata)


def decode_record(data: bytes) -> SceneRecord:
    """The record in safetensors bytes, its arrays read-only views of ``data``.

    Raises:
      ValueError: the bytes are no record, or one of another format, or its values contradict each other. A record that
        passes gives valid scenes in every crop.
    """
    arrays, origin = parse_record(data)
    arrays["agent_known"] = (arrays["agent_known"][:, None] & _KNOWN_BITS) != 0
    for name in _BOOLEANS:
        arrays[name] = arrays[name].view(bool)
    local_map = LocalMap(**{field: arrays[name] for field, name in _ARRAYS.items()})
    return SceneRecord(
        local_map, origin.domain, origin.cluster, origin.scene_id, origin.step, origin.object, origin.is_recorder
    )


def read_record(stored: RecordShards, index: SupportsIndex) -> SceneRecord:
    """The record ``index`` of shards.

    Raises:
      ValueError: naming the shard, if it cannot be read or decoded.
    """
    data = stored[index]
    try:
        return decode_record(data)
    except ValueError as error:
        raise ValueError(f"{stored.place(index)}: {error}") from error


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
