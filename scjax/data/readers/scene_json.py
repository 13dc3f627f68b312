"""Reader of "scene-json-1" files: recorded scenes of any source as plain float64 arrays.

One gzipped JSON object a scene: objects with T states each, map features, traffic-light states. Nothing is cleaned here
beyond structure: outliers pass, so that every consumer can decide for itself.
"""

from __future__ import annotations

import dataclasses
import gzip
import hashlib
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene import AgentType, Signal

SCHEMA = "scene-json-1"
REQUIRED_KEYS = ("dataset", "scene_id", "location_cluster", "timestamps", "has", "objects", "map", "tl_states")
FARTHEST = 1e7  # metres from the origin, a quarter of the way round the earth; more is damage
OTHER = -1  # objects that no class of ours stands for

_AGENT_TYPES = {
    "vehicle": AgentType.VEHICLE,
    "pedestrian": AgentType.PEDESTRIAN,
    "cyclist": AgentType.CYCLIST,
    "traffic_cone": AgentType.STATIC,
    "barrier": AgentType.STATIC,
}
_RIDDEN = "bicycle_parked_or_ridden"
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


@dataclasses.dataclass(frozen=True)
class RawLane:
    """One lane of a map as recorded, in driving direction; ids are strings whatever the source uses.

    ``left`` and ``right`` hold (lane id, own first point, own last point, its first point, its last point): point
    indices between which the two run side by side, or (id, None, None, None, None) for "all along".
    """

    id: str
    subtype: str | None
    points: Float64[np.ndarray, "points 3"]  # metres; z is NaN where it was not recorded
    predecessors: tuple[str, ...] = ()
    successors: tuple[str, ...] = ()
    left: tuple[tuple[Any, ...], ...] = ()
    right: tuple[tuple[Any, ...], ...] = ()


@dataclasses.dataclass(frozen=True)
class RawScene:
    """A recorded scene in the source's own frame (float64: coordinates may be tens of kilometres from the origin).

    Attributes:
      domain: name of the data set; cluster: scenes with equal (domain, cluster) share map geometry.
      lanes: every map feature of type lane, in file order.
      types: ``AgentType`` of each object, or OTHER.
      valid: whether the object was seen at a step; all other object arrays are meaningless where it is False.
      positions: box centre [m], z NaN where not recorded; headings [rad]; velocities [m/s].
      sizes: length, width, height [m], NaN where not recorded.
      signals: ``Signal`` of lane ``signal_lanes[i]`` (an id) at each step.
      recorder: index of the recording car, -1 where there is none.
    """

    path: str
    sha256: str
    domain: str
    scene_id: str
    cluster: str
    variant: str
    topology_given: bool
    timestamps: Float64[np.ndarray, " steps"]
    recorder: int
    lanes: tuple[RawLane, ...]
    types: Int[np.ndarray, " objects"]
    valid: Bool[np.ndarray, "objects steps"]
    positions: Float64[np.ndarray, "objects steps 3"]
    headings: Float64[np.ndarray, "objects steps"]
    velocities: Float64[np.ndarray, "objects steps 2"]
    sizes: Float64[np.ndarray, "objects 3"]
    signal_lanes: tuple[str, ...]
    signals: Int[np.ndarray, "signalled steps"]

    @property
    def num_steps(self) -> int:
        """T, the number of recorded time steps."""
        return len(self.timestamps)


def read_scene(path: str | Path) -> RawScene:
    """The scene in file ``path`` (``*.json.gz``, all data sets).

    Raises:
      ValueError: naming the file, what is wrong with it and what to do: unreadable or truncated gzip, no JSON, another
        schema, missing keys, arrays of unequal length, NaN coordinates, a map without lanes.
    """
    data = read_bytes(path)
    return parse_scene(data, path)


def read_bytes(path: str | Path) -> bytes:
    """The decompressed content of ``path``; ValueError naming the file where that fails."""
    try:
        packed = Path(path).read_bytes()
        if not packed:
            raise EOFError("it is empty")  # an empty string decompresses to nothing without complaint
        return gzip.decompress(packed)
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: not a complete gzip file ({error}): copy or download it again") from error


def parse_scene(data: bytes, path: str | Path) -> RawScene:
    """As ``read_scene``, from the decompressed bytes; ``path`` is for messages only."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON ({error}): copy or download it again") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        found = content.get("schema") if isinstance(content, dict) else type(content).__name__
        raise ValueError(f"{path}: schema is {found!r}, not {SCHEMA!r}: convert the scene first")
    missing = [key for key in REQUIRED_KEYS if key not in content]
    if missing:
        raise ValueError(f"{path}: missing {', '.join(missing)}: the file does not follow {SCHEMA}, write it again")
    try:
        return _build(content, hashlib.sha256(data).hexdigest(), str(path))
    except KeyError as error:
        raise ValueError(f"{path}: an object or map feature lacks the key {error}: write the file again") from error
    except (TypeError, AttributeError, IndexError) as error:
        raise ValueError(f"{path}: a value has an unexpected type ({error}): write the file again") from error
    except ValueError as error:
        if str(error).startswith(str(path)):
            raise
        raise ValueError(f"{path}: {error}: write the file again") from error


def _build(content: Mapping[str, Any], sha256: str, path: str) -> RawScene:
    timestamps = np.asarray(content["timestamps"], np.float64)
    steps = len(timestamps)
    if not steps:
        raise ValueError(f"{path}: timestamps is empty: a scene needs at least one step")
    lanes = tuple(_lane(item, path) for item in content["map"] if item["type"] == "lane")
    if not lanes:
        raise ValueError(f"{path}: the map has no lanes: leave this file out")
    objects = content["objects"]
    valid = _rows(objects, "valid", steps, path) > 0
    speeds = np.stack([_rows(objects, "vx", steps, path), _rows(objects, "vy", steps, path)], -1)
    position = [_rows(objects, axis, steps, path) for axis in ("x", "y")]
    headings = _rows(objects, "heading", steps, path)
    for name, values in (("x", position[0]), ("y", position[1]), ("heading", headings), ("velocity", speeds.sum(-1))):
        wrong = valid & ~(np.abs(values) < FARTHEST)
        if wrong.any():
            who, step = (int(i) for i in np.argwhere(wrong)[0])
            raise ValueError(f"{path}: {name} of object {who} at step {step} is {values[who, step]}: mark it invalid")
    z = _rows([{**item, "z": [np.nan] * steps} if item["z"] is None else item for item in objects], "z", steps, path)
    z[~(np.abs(z) < FARTHEST)] = np.nan
    sizes = [[item[key] for key in ("length", "width", "height")] for item in objects]
    recorder = content.get("sdc_index")
    if recorder is not None and not 0 <= recorder < len(objects):
        raise ValueError(f"{path}: sdc_index {recorder} is not an index into the {len(objects)} objects: correct it")
    lights = content["tl_states"]
    return RawScene(
        path=path,
        sha256=sha256,
        domain=str(content["dataset"]),
        scene_id=str(content["scene_id"]),
        cluster=str(content["location_cluster"]),
        variant=str(content.get("variant", "")),
        topology_given=content["has"].get("topology") == "given",
        timestamps=timestamps,
        recorder=-1 if recorder is None else int(recorder),
        lanes=lanes,
        types=_types(objects, valid, speeds),
        valid=valid,
        positions=np.stack([*position, z], -1),
        headings=headings,
        velocities=speeds,
        sizes=np.asarray(sizes, np.float64).reshape(len(objects), 3),
        signal_lanes=tuple(str(key) for key in lights),
        signals=_signals(lights, steps, path),
    )


def _rows(objects: list[Mapping[str, Any]], key: str, steps: int, path: str) -> Float64[np.ndarray, "objects steps"]:
    for index, item in enumerate(objects):
        if len(item[key]) != steps:
            raise ValueError(f"{path}: {key} of object {index} has {len(item[key])} values for {steps} timestamps")
    return np.asarray([item[key] for item in objects], np.float64).reshape(len(objects), steps)


def _types(objects: list[Mapping[str, Any]], valid: np.ndarray, velocities: np.ndarray) -> Int[np.ndarray, " objects"]:
    types = np.array([_AGENT_TYPES.get(item["type"], OTHER) for item in objects], np.int32).reshape(len(objects))
    for index, item in enumerate(objects):
        if item["type"] == _RIDDEN:
            # AV2 does not say which: a bicycle that moves has a rider, one that stands is an obstacle.
            speed = np.hypot(*velocities[index, valid[index]].T)
            types[index] = AgentType.CYCLIST if speed.size and np.median(speed) > 1.0 else AgentType.STATIC
    return types


def _signals(lights: Mapping[str, Any], steps: int, path: str) -> Int[np.ndarray, "signalled steps"]:
    states = np.zeros((len(lights), steps), np.int8)
    for row, (lane, light) in enumerate(lights.items()):
        if len(light["state"]) != steps:
            raise ValueError(f"{path}: signal of lane {lane} has {len(light['state'])} states for {steps} timestamps")
        states[row] = [_SIGNALS.get(state, Signal.UNKNOWN) for state in light["state"]]
    return states


def _lane(item: Mapping[str, Any], path: str) -> RawLane:
    x, y, z = item["x"], item["y"], item.get("z")
    if len(x) != len(y) or (z is not None and len(z) != len(x)):
        raise ValueError(f"{path}: x, y, z of lane {item['id']} differ in length")
    points = np.full((len(x), 3), np.nan)
    points[:, 0], points[:, 1] = x, y
    if not (np.abs(points[:, :2]) < FARTHEST).all():
        raise ValueError(f"{path}: lane {item['id']} has NaN or absurd coordinates: remove those points")
    if z is not None:
        points[:, 2] = np.asarray(z, np.float64)
        if not (np.abs(points[:, 2]) < FARTHEST).all():
            points[:, 2] = np.nan  # a lane's elevation is known as a whole or not at all
    return RawLane(
        id=str(item["id"]),
        subtype=item["subtype"],
        points=points,
        predecessors=tuple(str(i) for i in item.get("predecessors", ())),
        successors=tuple(str(i) for i in item.get("successors", ())),
        left=tuple((str(entry[0]), *entry[1:]) for entry in item.get("left_neighbors", ())),
        right=tuple((str(entry[0]), *entry[1:]) for entry in item.get("right_neighbors", ())),
    )
