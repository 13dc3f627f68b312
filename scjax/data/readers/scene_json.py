"""Reader of "scene-json-1" files: one gzipped JSON object per recorded scene, the same for every data set.

A file holds objects with T states each, map features and states of traffic lights. Only its structure is checked here:
outliers pass, so that every consumer can decide for itself.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from jaxtyping import Float64, Int
from msgspec import Meta, Struct

from scjax.data.readers.base import LogInfo, files_below
from scjax.data.readers.vocabulary import BICYCLE, LANE_WORDS, OBJECT_WORDS, SIGNAL_WORDS, look_up
from scjax.scene import NO_EGO, OTHER_OBJECT, AgentType, LaneNeighbor, Log, LogMetadata, MapLane, Signal, validate_log
from scjax.scene.document import convert_document, json_schema, parse_document
from scjax.scene.files import read_limited
from scjax.scene.limits import MAX_COORDINATE

SCHEMA = "scene-json-1"
PATTERN = "*.json.gz"
SKIPPED_FOLDERS = ("peer_outputs", "images")  # generated scenes and pictures; any folder whose name starts like this

_RIDDEN_SPEED = 1.0  # m/s, median speed above which a bicycle has a rider
MAX_STATES = 20_000_000
"""Objects times steps of a scene; more would fill the memory."""

_CURE = "write the file again"
Name = str | int
Numbers = list[float | None]


class FileSchema(Struct):
    """What is read first, to say that a file follows another schema."""

    schema: Any = None


class RecordedObject(Struct):
    """One object: its class, its size [m], and its states at every step."""

    type: str
    length: float | None
    width: float | None
    height: float | None
    valid: list[float | bool]
    x: Numbers
    y: Numbers
    z: Numbers | None
    heading: Numbers
    vx: Numbers
    vy: Numbers
    id: Name | None = None


class RecordedLane(Struct):
    """One lane: its centerline in driving direction, and the lanes around it."""

    x: Numbers
    y: Numbers
    z: Numbers | None = None
    subtype: str | None = None
    predecessors: list[Name] | None = None
    successors: list[Name] | None = None
    left_neighbors: list[Annotated[list[Name | None], Meta(min_length=1)]] | None = None
    right_neighbors: list[Annotated[list[Name | None], Meta(min_length=1)]] | None = None
    id: Name | None = None


class RecordedSignal(Struct):
    """States of a signal, and its stop point [m]."""

    state: list[str | None]
    x: float | None = None
    y: float | None = None
    z: float | None = None


class Presence(Struct):
    """What the file says it holds."""

    topology: str | None = None


class Recording(Struct):
    """A whole file; keys that the reader does not need are not read."""

    dataset: Name
    scene_id: Name
    location_cluster: Name | None
    timestamps: list[float]
    has: Presence
    objects: list[RecordedObject]
    map: list[dict[str, Any]]
    tl_states: dict[str, RecordedSignal]
    variant: Name | None = None
    sdc_index: int | None = None


def recording_schema() -> dict[str, Any]:
    """The JSON Schema of a file."""
    schema, lane = json_schema(Recording), json_schema(RecordedLane)
    schema["$defs"] |= lane["$defs"]
    fields = schema["$defs"]["Recording"]
    fields["properties"] = {"schema": {"const": SCHEMA}, **fields["properties"]}
    fields["required"] = ["schema", *fields["required"]]
    is_lane = {"properties": {"type": {"const": "lane"}}, "required": ["type"]}
    fields["properties"]["map"]["items"] = {"type": "object", "if": is_lane, "then": {"$ref": "#/$defs/RecordedLane"}}
    return schema


@dataclasses.dataclass(frozen=True)
class SceneJsonReader:
    """Every ``*.json.gz`` below a folder, except in folders of pictures and of generated scenes."""

    folder: str

    def __str__(self) -> str:
        return self.folder

    def names(self) -> list[str]:
        """Files relative to the folder, sorted.

        Raises:
          ValueError: if the folder does not exist or holds none.
        """
        return files_below(self.folder, PATTERN, SKIPPED_FOLDERS)

    def scan(self, name: str) -> LogInfo:
        """Hash, data set and location of a file, or the reason why it cannot be used."""
        path = Path(self.folder, name)
        try:
            data = _read_bytes(path)
            # Two values without parsing megabytes of JSON; anything unusual goes through the parser.
            matches = [
                re.findall(rb'"%s": ?("(?:[^"\\]|\\.)*")' % key, data) for key in (b"dataset", b"location_cluster")
            ]
            if all(len(values) == 1 for values in matches):
                domain, cluster = (json.loads(values[0]) for values in matches)
            else:
                metadata = _parse(data, path).metadata
                domain, cluster = metadata.domain, metadata.location_cluster
        except ValueError as error:
            return LogInfo(name, reason=str(error))
        return LogInfo(name, hashlib.sha256(data).hexdigest(), domain, cluster)

    def read(self, name: str) -> Log:
        """The log in a file of the folder.

        Raises:
          ValueError: as ``read_log``.
        """
        return read_log(Path(self.folder, name))


def read_log(path: str | Path) -> Log:
    """The log in a "scene-json-1" file (``*.json.gz``).

    Raises:
      ValueError: naming the file, what is wrong with it and what to do: unreadable or truncated gzip, no JSON, another
        schema, missing keys, arrays of unequal length, NaN coordinates, a map without lanes.
    """
    return _parse(_read_bytes(path), path)


def _read_bytes(path: str | Path) -> bytes:
    """The decompressed content of ``path``; ValueError naming the file where that fails."""
    try:
        return read_limited(path)
    except FileNotFoundError as error:
        raise ValueError(f"{path}: No such file: give a {PATTERN} file") from error
    except ValueError as error:
        raise ValueError(str(error).replace("not a complete file", "not a complete gzip file", 1)) from error


def _parse(data: bytes, path: str | Path) -> Log:
    """As ``read_log``, from the decompressed bytes; ``path`` is for messages only."""
    schema = parse_document(data, FileSchema, path, _CURE).schema
    if schema != SCHEMA:
        raise ValueError(f"{path}: schema is {str(schema)[:60]!r}, not {SCHEMA!r}: convert the scene first")
    content = parse_document(data, Recording, path, _CURE)
    try:
        return validate_log(_log_of(content, hashlib.sha256(data).hexdigest(), str(path)))
    except ValueError as error:
        text = str(error)
        raise ValueError(text if text.startswith(str(path)) else f"{path}: {text}") from error


def _log_of(content: Recording, sha256: str, path: str) -> Log:
    steps = len(content.timestamps)
    if not steps:
        raise ValueError("timestamps is empty: a scene needs at least one step")
    if steps * len(content.objects) > MAX_STATES:
        raise ValueError(f"{len(content.objects)} objects at {steps} steps are more than {MAX_STATES}: split the scene")
    unknown: Counter[str] = Counter()
    lanes = tuple(
        _read_lane(convert_document(item, RecordedLane, f"{path}: map[{index}]", _CURE), index, unknown)
        for index, item in enumerate(content.map)
        if _feature_type(item, f"{path}: map[{index}]") == "lane"
    )
    if not lanes:
        raise ValueError("the map has no lanes: leave this file out")
    objects, lights = content.objects, content.tl_states
    valid = _states(objects, "valid", steps) > 0
    velocities = np.stack([_states(objects, "vx", steps), _states(objects, "vy", steps)], -1)
    return Log(
        timestamps=np.array(content.timestamps, np.float64),
        object_ids=tuple(_id(item.id, index) for index, item in enumerate(objects)),
        object_types=_object_types(objects, valid, velocities, unknown),
        valid=valid,
        positions=np.stack([_states(objects, "x", steps), _states(objects, "y", steps), _heights(objects, steps)], -1),
        headings=_states(objects, "heading", steps),
        velocities=velocities,
        sizes=_columns(objects, ("length", "width", "height")),
        ego_index=NO_EGO if content.sdc_index is None else _index(content.sdc_index, len(objects)),
        signal_lane_ids=tuple(lights),
        signal_states=_signal_states(lights, steps, unknown),
        signal_positions=_columns(list(lights.values()), ("x", "y", "z")),
        lanes=lanes,
        has_topology=_has_topology(content.has, unknown),
        metadata=LogMetadata(
            domain=str(content.dataset),
            scene_id=str(content.scene_id),
            location_cluster=_cluster(content),
            variant=str(content.variant or ""),
            source_file=path,
            source_sha256=sha256,
            unknown_words=dict(sorted(unknown.items())),
        ),
    )


def _feature_type(item: dict[str, Any], name: str) -> str:
    if not isinstance(item.get("type"), str):
        raise ValueError(f"{name}: type is {item.get('type')!r:.60}, not a text: {_CURE}")
    return item["type"]


def _cluster(content: Recording) -> str:
    """The location; a scene of which it is not known is a location of its own."""
    known = content.location_cluster
    return f"scene {content.scene_id}" if known is None else str(known)


def _has_topology(has: Presence, unknown: Counter[str]) -> bool:
    if has.topology not in ("given", "infer", None):
        unknown[f"has.topology: {has.topology[:60]}"] += 1
    return has.topology == "given"


def _states(objects: Sequence[RecordedObject], key: str, steps: int) -> Float64[np.ndarray, "objects steps"]:
    """One value per object and step; null becomes NaN."""
    for index, item in enumerate(objects):
        if len(getattr(item, key)) != steps:
            raise ValueError(
                f"{key} of object {index} has {len(getattr(item, key))} values for {steps} timestamps: {_CURE}"
            )
    return np.array([getattr(item, key) for item in objects], np.float64).reshape(len(objects), steps)


def _heights(objects: Sequence[RecordedObject], steps: int) -> Float64[np.ndarray, "objects steps"]:
    """z of the box centers [m], NaN where it is missing or absurd."""
    unknown: Numbers = [None] * steps
    for item in objects:
        item.z = unknown if item.z is None else item.z
    return _nan_where_absurd(_states(objects, "z", steps))


def _columns(items: Sequence[Any], keys: tuple[str, ...]) -> Float64[np.ndarray, "items keys"]:
    """One value per item and key, NaN where it is null."""
    values = [[getattr(item, key) for key in keys] for item in items]
    return np.array(values, np.float64).reshape(len(items), len(keys))


def _index(value: int, count: int) -> int:
    if not 0 <= value < count:
        raise ValueError(f"sdc_index {value} is not an index into the {count} objects: correct it")
    return value


def _id(value: str | int | None, index: int) -> str:
    """Id of an object or lane; some sources have none."""
    return f"unnamed-{index}" if value is None else str(value)


def _object_types(
    objects: Sequence[RecordedObject], valid: np.ndarray, velocities: np.ndarray, unknown: Counter[str]
) -> Int[np.ndarray, " objects"]:
    types = [look_up(OBJECT_WORDS, item.type, OTHER_OBJECT, "object type", unknown) for item in objects]
    for index, agent_type in enumerate(types):
        if agent_type == BICYCLE:
            # Some sources do not say which: a bicycle that moves has a rider, one that stands is an obstacle.
            speed = np.hypot(*velocities[index, valid[index]].T)
            ridden = speed.size and np.median(speed) > _RIDDEN_SPEED
            types[index] = AgentType.CYCLIST if ridden else AgentType.STATIC
    return np.array(types, np.int32).reshape(len(objects))


def _signal_states(
    lights: Mapping[str, RecordedSignal], steps: int, unknown: Counter[str]
) -> Int[np.ndarray, "signals steps"]:
    states = np.zeros((len(lights), steps), np.int8)
    for row, (lane, light) in enumerate(lights.items()):
        if len(light.state) != steps:
            raise ValueError(f"signal of lane {lane} has {len(light.state)} states for {steps} timestamps: {_CURE}")
        states[row] = [
            Signal.UNKNOWN if word is None else look_up(SIGNAL_WORDS, word, Signal.UNKNOWN, "signal state", unknown)
            for word in light.state
        ]
    return states


def _read_lane(item: RecordedLane, index: int, unknown: Counter[str]) -> MapLane:
    name = _id(item.id, index)
    if len(item.x) != len(item.y) or (item.z is not None and len(item.z) != len(item.x)):
        raise ValueError(f"x, y, z of lane {name} differ in length: {_CURE}")
    points = np.full((len(item.x), 3), np.nan)
    points[:, 0], points[:, 1] = item.x, item.y
    if item.z is not None:
        points[:, 2] = _nan_where_absurd(np.array(item.z, np.float64))
        if np.isnan(points[:, 2]).any():
            points[:, 2] = np.nan  # the elevation of a lane is known as a whole or not at all
    subtype = item.subtype
    return MapLane(
        id=name,
        lane_type=None if subtype is None else look_up(LANE_WORDS, subtype, None, "lane subtype", unknown),
        points=points,
        predecessors=tuple(map(str, item.predecessors or ())),
        successors=tuple(map(str, item.successors or ())),
        left_neighbors=tuple(_neighbor(entry, name) for entry in item.left_neighbors or ()),
        right_neighbors=tuple(_neighbor(entry, name) for entry in item.right_neighbors or ()),
    )


def _neighbor(entry: list[str | int | None], lane: str) -> LaneNeighbor:
    identity, span = entry[0], entry[1:]
    if identity is None or len(span) not in (0, 4) or not all(i is None or isinstance(i, int) for i in span):
        raise ValueError(f"a neighbor of lane {lane} is {entry}: give [lane id] and four point indices or nulls")
    return LaneNeighbor(str(identity), *cast(Any, span))


def _nan_where_absurd(values: np.ndarray) -> np.ndarray:
    return np.where(np.abs(values) < MAX_COORDINATE, values, np.nan)
