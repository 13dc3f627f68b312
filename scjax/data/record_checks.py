"""What the bytes of a record must hold: names, types, shapes and ranges, checked once when it is decoded.

Whatever passes gives scenes that ``scjax.validate`` accepts, in every crop. Nothing loops over lanes or agents, since
training decodes a record for every example.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Generic, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct

from scjax.data.local_map import RADIUS
from scjax.scene.document import parse_document
from scjax.scene.limits import MAX_COORDINATE, MAX_SIZE, MAX_SLOTS, MAX_SPEED

RECORD_FORMAT = 1
CURE = "build the records again"
NUM_KNOWN = 9  # bits of agent_known
DTYPES = {
    "points": np.float32,
    "offsets": np.int32,
    "lane_z_known": np.uint8,
    "edges": np.int16,
    "beside": np.int16,
    "spans": np.float32,
    "signals": np.uint8,
    "agents": np.float32,
    "agent_types": np.uint8,
    "agent_known": np.uint16,
    "off_road": np.uint8,
}
"""Type of each array by its name in a record."""

_ROWS = {  # arrays that have as many rows
    "lanes": ("lane_z_known", "signals"),
    "agents": ("agents", "agent_types", "agent_known", "off_road"),
    "pairs": ("beside", "spans"),
}
_HIGHEST = {"lane_z_known": 1, "off_road": 1, "signals": 3, "agent_types": 3, "agent_known": (1 << NUM_KNOWN) - 1}
_MAX_PAIRS = 1 << 15
_UNIT = 1e-3  # by which the length of a heading may differ from 1
_REACH = RADIUS + 1.0  # m; rounding may put a point outside of the radius
_POINT_BOUNDS = np.array([_REACH, _REACH, MAX_COORDINATE], np.float32)
_AGENT_BOUNDS = np.array([*_POINT_BOUNDS, MAX_SPEED, 1.1, 1.1, MAX_SIZE, MAX_SIZE, MAX_SIZE], np.float32)

_highest, _lowest, _all = np.maximum.reduce, np.minimum.reduce, np.logical_and.reduce  # methods cost twice as much

_Count = Annotated[int, Meta(ge=0, lt=2**31)]
_Dtype = TypeVar("_Dtype")
_Shape = TypeVar("_Shape")


class _Array(Struct, Generic[_Dtype, _Shape], forbid_unknown_fields=True):
    dtype: _Dtype
    shape: _Shape
    data_offsets: tuple[_Count, _Count]


class _Metadata(Struct):
    record: str


_Floats = Literal["F32"]
_Indices = Literal["I16"]
_Bytes = Literal["U8"]
_Vector = tuple[_Count]


class _Header(Struct, forbid_unknown_fields=True):
    """The safetensors header of a record."""

    points: _Array[_Floats, tuple[_Count, Literal[3]]]
    offsets: _Array[Literal["I32"], _Vector]
    lane_z_known: _Array[_Bytes, _Vector]
    edges: _Array[_Indices, tuple[_Count, Literal[2]]]
    beside: _Array[_Indices, tuple[_Count, Literal[2]]]
    spans: _Array[_Floats, tuple[_Count, Literal[4]]]
    signals: _Array[_Bytes, _Vector]
    agents: _Array[_Floats, tuple[_Count, Literal[9]]]
    agent_types: _Array[_Bytes, _Vector]
    agent_known: _Array[Literal["U16"], _Vector]
    off_road: _Array[_Bytes, _Vector]
    metadata: _Metadata = msgspec.field(name="__metadata__")


class Origin(Struct, forbid_unknown_fields=True):
    """Where a record comes from; see ``SceneRecord``."""

    format: Literal[1]
    domain: _Count
    cluster: str
    scene_id: str
    step: _Count
    object: _Count
    is_recorder: bool


class _AnyHeader(Struct):
    metadata: _Metadata = msgspec.field(name="__metadata__")


class _AnyOrigin(Struct):
    format: int


def parse_record(data: bytes) -> tuple[dict[str, np.ndarray], Origin]:
    """The arrays of a record as they are stored, read-only views of ``data``, and where it comes from.

    Raises:
      ValueError: the bytes are no record, or one of another format, or its values contradict each other.
    """
    name = f"data: {len(data)} bytes, but no scene record"
    base = 8 + int.from_bytes(data[:8], "little")
    try:
        header = parse_document(data[8:base], _Header, f"{name}; header", CURE)
        origin = parse_document(header.metadata.record, Origin, f"{name}; origin", CURE)
    except ValueError:
        version = _format_of(data[8:base])
        if version not in (None, RECORD_FORMAT):
            raise ValueError(f"data: record format {version}, not {RECORD_FORMAT}: {CURE}") from None
        raise
    arrays, total = {}, 0
    for key, dtype in DTYPES.items():
        entry = getattr(header, key)
        start, end = entry.data_offsets
        shape = entry.shape
        count = shape[0] if len(shape) == 1 else shape[0] * shape[1]
        size = count * np.dtype(dtype).itemsize
        if end - start != size or base + end > len(data):
            raise ValueError(f"{name} ({key} is cut short): {CURE}")
        arrays[key] = np.frombuffer(data, dtype, count, base + start).reshape(shape)
        total += size
    if base + total != len(data):
        raise ValueError(f"{name} (its arrays do not fill it): {CURE}")
    if fault := find_fault(arrays):
        raise ValueError(f"{name} ({fault}): {CURE}")
    return arrays, origin


def find_fault(arrays: Mapping[str, np.ndarray]) -> str:
    """What is wrong with the arrays of a record of sound types, as a clause; empty if nothing is."""
    return _fault_of_shapes(arrays) or _fault_of_lanes(arrays) or _fault_of_agents(arrays)


def _fault_of_shapes(arrays: Mapping[str, np.ndarray]) -> str:
    rows = {"lanes": len(arrays["offsets"]) - 1, "agents": len(arrays["agents"]), "pairs": len(arrays["beside"])}
    for kind, names in _ROWS.items():
        for name in names:
            if len(arrays[name]) != rows[kind]:
                return f"{name} has {len(arrays[name])} rows for {rows[kind]} {kind}"
    if not rows["agents"]:
        return "agents has no ego"
    if not 0 <= rows["lanes"] <= MAX_SLOTS or rows["pairs"] >= _MAX_PAIRS:
        return f"it has {rows['lanes']} lanes and {rows['pairs']} pairs of neighbors"
    for name, highest in _HIGHEST.items():
        if _highest(arrays[name], initial=0) > highest:
            return f"{name} holds values above {highest}"
    return ""


def _fault_of_lanes(arrays: Mapping[str, np.ndarray]) -> str:
    points, offsets = arrays["points"], arrays["offsets"]
    ends = offsets.astype(np.int64)  # differences of 32 bits could wrap around
    if ends[0] != 0 or ends[-1] != len(points) or _lowest(ends[1:] - ends[:-1], initial=2) < 2:
        return f"offsets do not divide {len(points)} points into lanes of at least 2"
    if not _all(np.abs(points) < _POINT_BOUNDS, axis=None):
        return f"points holds NaN, or lies outside of {RADIUS:g} m"
    lanes = len(offsets) - 1
    for name in ("edges", "beside"):
        if (
            arrays[name].size and _highest(arrays[name].view(np.uint16), axis=None) >= lanes
        ):  # negative ones are the largest
            return f"{name} names lanes outside of 0..{lanes - 1}"
    spans = arrays["spans"]
    if not len(spans):
        return ""
    if not (_highest(np.abs(spans), axis=None) < MAX_COORDINATE and _all(spans[:, ::2] <= spans[:, 1::2], axis=None)):
        return "spans holds NaN, or ends that come before starts"
    left, right = arrays["beside"].T.astype(np.int64)
    is_pair = np.zeros(lanes * lanes, bool)
    is_pair[left * lanes + right] = True
    if np.logical_or.reduce(is_pair[right * lanes + left]):
        return "beside holds lanes on the left and on the right of each other"
    return ""


def _fault_of_agents(arrays: Mapping[str, np.ndarray]) -> str:
    agents = arrays["agents"]
    if not _all(np.abs(agents) < _AGENT_BOUNDS, axis=None):
        return f"agents holds NaN, lies outside of {RADIUS:g} m, or has a speed or size that no agent has"
    if _lowest(agents[:, 6:], axis=None) <= 0:
        return "agents holds sizes of 0 m or less"
    cos, sin = agents[:, 4], agents[:, 5]
    if _highest(np.abs(cos * cos + sin * sin - 1)) > 2 * _UNIT:
        return "agents holds headings that are no unit vector"
    return ""


def _format_of(header: bytes) -> Any:
    try:
        return msgspec.json.decode(msgspec.json.decode(header, type=_AnyHeader).metadata.record, type=_AnyOrigin).format
    except (msgspec.MsgspecError, UnicodeError, RecursionError):
        return None
