"""Reader of "scene-json-1" files: one gzipped JSON object per recorded scene, the same for every data set.

A file holds objects with T states each, map features and states of traffic lights. Only its structure is checked here:
outliers pass, so that every consumer can decide for itself.
"""

from __future__ import annotations

import dataclasses
import gzip
import hashlib
import json
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int

from scjax.data.readers.base import LogInfo
from scjax.scene import NO_EGO, OTHER_OBJECT, AgentType, LaneNeighbor, Log, LogMetadata, MapLane, Signal, validate_log
from scjax.scene.limits import MAX_COORDINATE

SCHEMA = "scene-json-1"
REQUIRED_KEYS = ("dataset", "scene_id", "location_cluster", "timestamps", "has", "objects", "map", "tl_states")
PATTERN = "*.json.gz"
SKIPPED_FOLDERS = ("peer_outputs", "images")  # generated scenes and pictures; any folder whose name starts like this

_AGENT_TYPES = {
    "vehicle": AgentType.VEHICLE,
    "pedestrian": AgentType.PEDESTRIAN,
    "cyclist": AgentType.CYCLIST,
    "traffic_cone": AgentType.STATIC,
    "barrier": AgentType.STATIC,
}
_BICYCLE = "bicycle_parked_or_ridden"
_RIDDEN_SPEED = 1.0  # m/s, median speed above which a bicycle has a rider
_SIGNALS = {
    "unknown": Signal.UNKNOWN,
    "go": Signal.GO,
    "arrow_go": Signal.GO,
    "caution": Signal.CAUTION,
    "arrow_caution": Signal.CAUTION,
    "flashing_caution": Signal.CAUTION,
    "stop": Signal.STOP,
    "arrow_stop": Signal.STOP,
    "flashing_stop": Signal.STOP,
}
_NO_STOP_POINT = {"x": None, "y": None, "z": None}


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
        folder = Path(self.folder)
        if not folder.is_dir():
            raise ValueError(f"{folder}: no such folder: give the folder that holds the {PATTERN} scenes")
        paths = (path.relative_to(folder) for path in folder.rglob(PATTERN))
        files = sorted(
            path.as_posix() for path in paths if not any(part.startswith(SKIPPED_FOLDERS) for part in path.parts[:-1])
        )
        if not files:
            raise ValueError(f"{folder}: no {PATTERN} scenes there: give the folder that holds them")
        return files

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
        compressed = Path(path).read_bytes()
        if not compressed:
            raise EOFError("it is empty")  # an empty string decompresses to nothing without complaint
        return gzip.decompress(compressed)
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: not a complete gzip file ({error}): copy or download it again") from error


def _parse(data: bytes, path: str | Path) -> Log:
    """As ``read_log``, from the decompressed bytes; ``path`` is for messages only."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON ({error}): copy or download it again") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        schema = content.get("schema") if isinstance(content, dict) else type(content).__name__
        raise ValueError(f"{path}: schema is {schema!r}, not {SCHEMA!r}: convert the scene first")
    missing = [key for key in REQUIRED_KEYS if key not in content]
    if missing:
        raise ValueError(f"{path}: missing {', '.join(missing)}: the file does not follow {SCHEMA}, write it again")
    try:
        return validate_log(_log_from_json(content, hashlib.sha256(data).hexdigest(), str(path)))
    except KeyError as error:
        raise ValueError(f"{path}: an object or map feature lacks the key {error}: write the file again") from error
    except (TypeError, AttributeError, IndexError) as error:
        raise ValueError(f"{path}: a value has an unexpected type ({error}): write the file again") from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _log_from_json(content: Mapping[str, Any], sha256: str, path: str) -> Log:
    timestamps = _floats(content["timestamps"], "timestamps")
    steps = len(timestamps)
    if not steps:
        raise ValueError("timestamps is empty: a scene needs at least one step")
    lanes = tuple(_read_lane(item, index) for index, item in enumerate(content["map"]) if item["type"] == "lane")
    if not lanes:
        raise ValueError("the map has no lanes: leave this file out")
    objects, lights = content["objects"], content["tl_states"]
    valid = _states(objects, "valid", steps) > 0
    velocities = np.stack([_states(objects, "vx", steps), _states(objects, "vy", steps)], -1)
    ego_index = content.get("sdc_index")
    return Log(
        timestamps=timestamps,
        object_ids=tuple(_id(item, index) for index, item in enumerate(objects)),
        object_types=_object_types(objects, valid, velocities),
        valid=valid,
        positions=np.stack([_states(objects, "x", steps), _states(objects, "y", steps), _heights(objects, steps)], -1),
        headings=_states(objects, "heading", steps),
        velocities=velocities,
        sizes=_columns(objects, ("length", "width", "height")),
        ego_index=NO_EGO if ego_index is None else _index(ego_index, len(objects)),
        signal_lane_ids=tuple(str(key) for key in lights),
        signal_states=_signal_states(lights, steps),
        signal_positions=_columns([_NO_STOP_POINT | light for light in lights.values()], ("x", "y", "z")),
        lanes=lanes,
        has_topology=content["has"].get("topology") == "given",
        metadata=LogMetadata(
            domain=str(content["dataset"]),
            scene_id=str(content["scene_id"]),
            location_cluster=str(content["location_cluster"]),
            variant=str(content.get("variant", "")),
            source_file=path,
            source_sha256=sha256,
        ),
    )


def _states(objects: list[Mapping[str, Any]], key: str, steps: int) -> Float64[np.ndarray, "objects steps"]:
    """One value per object and step."""
    for index, item in enumerate(objects):
        if len(item[key]) != steps:
            raise ValueError(
                f"{key} of object {index} has {len(item[key])} values for {steps} timestamps: write the file again"
            )
    return _floats([item[key] for item in objects], key).reshape(len(objects), steps)


def _floats(values: Any, name: str) -> Float64[np.ndarray, ...]:
    """``values`` as an array; null becomes NaN."""
    try:
        return np.asarray(values, np.float64)
    except ValueError as error:
        raise ValueError(f"{name}: {error}: write the file again") from error


def _heights(objects: list[Mapping[str, Any]], steps: int) -> Float64[np.ndarray, "objects steps"]:
    """z of the box centers [m], NaN where it is missing or absurd."""
    known = [{"z": [np.nan] * steps} if item["z"] is None else item for item in objects]
    return _nan_where_absurd(_states(known, "z", steps))


def _columns(items: list[Mapping[str, Any]], keys: tuple[str, ...]) -> Float64[np.ndarray, "items keys"]:
    """One value per item and key, NaN where it is null."""
    return _floats([[item[key] for key in keys] for item in items], ", ".join(keys)).reshape(len(items), len(keys))


def _index(value: Any, count: int) -> int:
    if not 0 <= value < count:
        raise ValueError(f"sdc_index {value} is not an index into the {count} objects: correct it")
    return int(value)


def _id(item: Mapping[str, Any], index: int) -> str:
    """Id of an object or lane; some sources have none."""
    return f"unnamed-{index}" if item["id"] is None else str(item["id"])


def _object_types(
    objects: list[Mapping[str, Any]], valid: np.ndarray, velocities: np.ndarray
) -> Int[np.ndarray, " objects"]:
    types = np.array([_AGENT_TYPES.get(item["type"], OTHER_OBJECT) for item in objects], np.int32)
    for index, item in enumerate(objects):
        if item["type"] == _BICYCLE:
            # AV2 does not say which: a bicycle that moves has a rider, one that stands is an obstacle.
            speed = np.hypot(*velocities[index, valid[index]].T)
            ridden = speed.size and np.median(speed) > _RIDDEN_SPEED
            types[index] = AgentType.CYCLIST if ridden else AgentType.STATIC
    return types.reshape(len(objects))


def _signal_states(lights: Mapping[str, Any], steps: int) -> Int[np.ndarray, "signals steps"]:
    states = np.zeros((len(lights), steps), np.int8)
    for row, (lane, light) in enumerate(lights.items()):
        if len(light["state"]) != steps:
            raise ValueError(
                f"signal of lane {lane} has {len(light['state'])} states for {steps} timestamps: write the file again"
            )
        states[row] = [_SIGNALS.get(state, Signal.UNKNOWN) for state in light["state"]]
    return states


def _read_lane(item: Mapping[str, Any], index: int) -> MapLane:
    name = _id(item, index)
    x, y, z = item["x"], item["y"], item.get("z")
    if len(x) != len(y) or (z is not None and len(z) != len(x)):
        raise ValueError(f"x, y, z of lane {name} differ in length: write the file again")
    points = np.full((len(x), 3), np.nan)
    points[:, 0], points[:, 1] = x, y
    if z is not None:
        points[:, 2] = _nan_where_absurd(_floats(z, f"z of lane {name}"))
        if np.isnan(points[:, 2]).any():
            points[:, 2] = np.nan  # the elevation of a lane is known as a whole or not at all
    return MapLane(
        id=name,
        lane_type=item["subtype"],
        points=points,
        predecessors=tuple(str(i) for i in item.get("predecessors", ())),
        successors=tuple(str(i) for i in item.get("successors", ())),
        left_neighbors=tuple(LaneNeighbor(str(lane), *span) for lane, *span in item.get("left_neighbors", ())),
        right_neighbors=tuple(LaneNeighbor(str(lane), *span) for lane, *span in item.get("right_neighbors", ())),
    )


def _nan_where_absurd(values: np.ndarray) -> np.ndarray:
    return np.where(np.abs(values) < MAX_COORDINATE, values, np.nan)
