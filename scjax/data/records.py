"""Training records: all that lies within 80 m of one ego pose, as safetensors bytes in ArrayRecord shards.

A record is cut once and cropped on every access, so one record yields any window, layout and pose jitter. Lanes are
simplified to 0.1 mm first: cropping costs by the point, and nobody sees 0.2 mm.
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

from scjax.data import ragged
from scjax.data.agents import clean
from scjax.data.crop import WINDOWS, Context, crop_scene, neighbour_pieces
from scjax.data.lane_graph import LaneGraph, SegmentIndex
from scjax.data.readers.scene_json import RawScene
from scjax.data.tiles import Pose, agents_at, to_pose_frame
from scjax.scene import Crop, Scene

RECORD_FORMAT = 1
RADIUS = 80.0  # metres; the far corners of the forward window are 71.6 m away
SIMPLIFY = 1e-4  # metres
_KNOWN_BITS = 1 << np.arange(9, dtype=np.uint16)


@dataclasses.dataclass(frozen=True)
class Record:
    """A context and where it comes from; ``domain`` is an index into the manifest's list of data sets."""

    context: Context
    domain: int
    cluster: str
    scene_id: str
    step: int
    object: int
    is_recorder: bool


def simplified(graph: LaneGraph) -> LaneGraph:
    """``graph`` with fewer points, none of which moves by more than 0.1 mm: what ``make_record`` wants.

    Spans keep their meaning: arc lengths change by far less than their resolution.
    """
    points, offsets = ragged.simplify(graph.points, graph.offsets, SIMPLIFY)
    return dataclasses.replace(graph, points=points, offsets=offsets)


def make_record(
    raw: RawScene, graph: LaneGraph, index: SegmentIndex, pose: Pose, domain: int
) -> tuple[Record, dict[str, int]]:
    """The record around ``pose`` and the counts of cleaned agent values (``agents.clean``).

    Args:
      graph: simplified lanes of ``raw``; index: the search structure of the unsimplified ones.
    """
    pieces = ragged.clip(to_pose_frame(graph.points, pose), graph.offsets, (-RADIUS, RADIUS, -RADIUS, RADIUS))
    beside, spans = neighbour_pieces(pieces, graph.beside, graph.spans, graph.num_lanes, overlap=0.0)
    found = agents_at(raw, index, pose, RADIUS)
    states, known, counts = clean(found.states, found.types)
    context = Context(
        points=np.nan_to_num(pieces.points, nan=0.0).astype(np.float32),
        offsets=pieces.offsets.astype(np.int32),
        lane_z_known=~np.isnan(pieces.points[pieces.offsets[:-1], 2]),
        edges=ragged.piece_edges(pieces, graph.edges, graph.num_lanes).astype(np.int16),
        beside=beside.astype(np.int16),
        spans=spans.astype(np.float32),
        signals=graph.signals[pieces.source, pose.step].astype(np.uint8),
        agents=states.astype(np.float32),
        agent_types=found.types.astype(np.uint8),
        agent_known=known,
        off_road=found.off_road,
    )
    record = Record(context, domain, raw.cluster, raw.scene_id, pose.step, pose.object, pose.is_recorder)
    return record, counts


def encode(record: Record) -> bytes:
    """``record`` as safetensors bytes."""
    arrays = {field.name: getattr(record.context, field.name) for field in dataclasses.fields(Context)}
    arrays["agent_known"] = (arrays["agent_known"] @ _KNOWN_BITS).astype(np.uint16)
    for name in ("off_road", "lane_z_known"):
        arrays[name] = arrays[name].astype(np.uint8)
    origin = {f.name: getattr(record, f.name) for f in dataclasses.fields(Record) if f.name != "context"}
    # One key, since safetensors writes several in random order and equal records shall be equal bytes.
    metadata = {"record": json.dumps({"format": RECORD_FORMAT, **origin})}
    return safetensors.numpy.save({k: np.ascontiguousarray(v) for k, v in arrays.items()}, metadata)


_DTYPES = {"F32": np.float32, "F64": np.float64, "I64": np.int64, "I32": np.int32, "I16": np.int16, "U16": np.uint16,
           "U8": np.uint8}  # fmt: skip


def decode(data: bytes) -> Record:
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
            for name in ("off_road", "lane_z_known"):
                arrays[name] = arrays[name].view(bool)
            return Record(Context(**arrays), **origin)
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"data: {len(data)} bytes, but no scene record ({error}): build the records again") from error
    raise ValueError(f"data: record format {version}, not {RECORD_FORMAT}: build the records again")


def _view(data: bytes, base: int, entry: dict[str, Any]) -> np.ndarray:
    start, end = entry["data_offsets"]
    dtype = np.dtype(_DTYPES[entry["dtype"]])
    return np.frombuffer(data, dtype, (end - start) // dtype.itemsize, base + start).reshape(entry["shape"])


def sample_scene(
    record: Record,
    crop: Crop = Crop.CENTERED,
    dx: float = 0.0,
    dy: float = 0.0,
    dyaw: float = 0.0,
    *,
    off_road: bool = False,
) -> Scene:
    """The unpadded NumPy scene of ``record`` in ``crop``, from a pose moved by dx, dy [m] and dyaw [rad].

    At zero offset and CENTRED this is the evaluation tile. See ``crop.crop`` for the rules.

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
    return crop_scene(record.context, crop, dx=dx, dy=dy, dyaw=dyaw, domain=record.domain, off_road=off_road)


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


def source(folder: str | Path, split: str) -> Any:
    """The encoded records (bytes, for ``decode``) of a split, in file order: len(), [index] and iteration.

    Raises:
      ValueError: as ``shard_paths``.
    """
    return array_record_data_source.ArrayRecordDataSource([str(path) for path in shard_paths(folder, split)])
