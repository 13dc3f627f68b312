"""Reader of ScenarioNet and MetaDrive scenarios (.pkl): tracks, lights and map in one dict, read as plain data."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scjax.data.readers.base import FileFormat, naming_file, read_file_bytes
from scjax.data.readers.restricted_pickle import load_plain_pickle
from scjax.data.readers.scene_json import MAX_STATES
from scjax.data.readers.vocabulary import BICYCLE, LANE_WORDS, OBJECT_WORDS, SIGNAL_WORDS, canonical, look_up
from scjax.scene import NO_EGO, OTHER_OBJECT, AgentType, LaneNeighbor, Log, LogMetadata, MapLane, Signal, validate_log

SCENARIONET_DOMAIN = "scenarionet"
_CURE = "convert the scenario again with ScenarioNet"
_DEFAULT_STEP = 0.1  # s
_NEIGHBOR_KEYS = ("self_start_index", "self_end_index", "neighbor_start_index", "neighbor_end_index")


def read_scenarionet(path: str | Path, location: str = "") -> Log:
    """The scenario in a ScenarioNet file (.pkl). Nothing in the file is executed.

    Args:
      location: ``LogMetadata.location_cluster``; the scenario's id by default.

    Raises:
      ValueError: naming the file and the field, what is wrong with it and what to do.
    """
    path = Path(path)
    data = read_file_bytes(path)
    with naming_file(path):
        content = load_plain_pickle(data)
        if not isinstance(content, dict) or not {"tracks", "map_features"} <= content.keys():
            raise ValueError(f"it holds no scenario with tracks and map_features: {_CURE}")
        return validate_log(_scenario_log(content, path, location, hashlib.sha256(data).hexdigest()))


def _scenario_log(content: dict[str, Any], path: Path, location: str, sha256: str) -> Log:
    metadata = _mapping(content.get("metadata", {}), "metadata")
    steps = _steps(content, metadata)
    unknown: Counter[str] = Counter()
    notes: Counter[str] = Counter()
    tracks = {
        str(name): _mapping(track, f"tracks[{name}]") for name, track in _mapping(content["tracks"], "tracks").items()
    }
    if steps * max(len(tracks), 1) > MAX_STATES:
        raise ValueError(f"{len(tracks)} tracks at {steps} steps are more than {MAX_STATES}: split the scenario")
    features = {
        str(k): _mapping(v, f"map_features[{k}]") for k, v in _mapping(content["map_features"], "map_features").items()
    }
    has_elevation = metadata.get("dataset") != "nuscenes"  # the third column of its lanes is their direction
    lanes = tuple(
        _feature_lane(name, feature, unknown, has_elevation) for name, feature in features.items() if _is_lane(feature)
    )
    if not lanes:
        raise ValueError(f"map_features holds no lanes: {_CURE}")
    states = {name: _TrackStates(name, track, steps) for name, track in tracks.items()}
    lights = _lights(_mapping(content.get("dynamic_map_states", {}), "dynamic_map_states"), steps, unknown)
    rows = list(states.values())
    others = Counter(
        word for feature in features.values() if not _is_lane(feature) for word in [str(feature.get("type"))]
    )
    notes.update({f"map features {word[:40]}, not read": count for word, count in others.items()})
    ego = str(metadata.get("sdc_id", ""))
    return Log(
        timestamps=_timestamps(metadata, steps),
        object_ids=tuple(tracks),
        object_types=np.array([_object_type(track, states[name], unknown) for name, track in tracks.items()], np.int32),
        valid=np.array([row.valid for row in rows], bool).reshape(-1, steps),
        positions=np.array([row.positions for row in rows], np.float64).reshape(-1, steps, 3),
        headings=np.array([row.headings for row in rows], np.float64).reshape(-1, steps),
        velocities=np.array([row.velocities for row in rows], np.float64).reshape(-1, steps, 2),
        sizes=np.array([row.size for row in rows], np.float64).reshape(-1, 3),
        ego_index=list(tracks).index(ego) if ego in tracks else NO_EGO,
        signal_lane_ids=tuple(lights),
        signal_states=np.array([light[0] for light in lights.values()], np.int8).reshape(-1, steps),
        signal_positions=np.array([light[1] for light in lights.values()], np.float64).reshape(-1, 3),
        lanes=lanes,
        has_topology=any(lane.successors or lane.predecessors for lane in lanes),
        metadata=LogMetadata(
            domain=str(metadata.get("dataset") or SCENARIONET_DOMAIN)[:60],
            scene_id=str(content.get("id") or path.stem)[:200],
            location_cluster=location or str(content.get("id") or path.stem)[:200],
            variant="scenarionet",
            source_file=str(path),
            source_sha256=sha256,
            unknown_words=dict(sorted(unknown.items())),
            notes=dict(sorted(notes.items())),
        ),
    )


class _TrackStates:
    """States of one track at every step: valid, positions, headings, velocities, and the median of its sizes."""

    def __init__(self, name: str, track: Mapping[str, Any], steps: int):
        state = _mapping(track.get("state"), f"tracks[{name}].state")
        field = f"tracks[{name}].state"
        self.valid = _numbers(state.get("valid"), (steps,), f"{field}.valid") > 0
        self.positions = _numbers(state.get("position"), (steps, 3), f"{field}.position")
        self.headings = _numbers(state.get("heading"), (steps,), f"{field}.heading")
        self.velocities = _numbers(state.get("velocity"), (steps, 2), f"{field}.velocity")
        for values in (self.positions, self.headings, self.velocities):
            values[~self.valid] = 0.0
        sizes = [_sizes(state.get(key), steps, f"{field}.{key}")[self.valid] for key in ("length", "width", "height")]
        self.size = [float(np.nanmedian(size)) if np.isfinite(size).any() else float("nan") for size in sizes]


def _sizes(values: Any, steps: int, name: str) -> np.ndarray:
    """A size at every step [m], NaN where it is not recorded."""
    if values is None:
        return np.full(steps, np.nan)
    array = np.asarray(values)
    sizes = np.full(steps, float(array)) if array.ndim == 0 and array.dtype.kind in "iuf" else None
    sizes = _numbers(values, (steps,), name) if sizes is None else sizes
    return np.where(sizes > 0, sizes, np.nan)


def _steps(content: Mapping[str, Any], metadata: Mapping[str, Any]) -> int:
    steps = content.get("length", len(metadata.get("ts", ())))
    if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or not 1 <= steps <= MAX_STATES:
        raise ValueError(f"length is {str(steps)[:40]}: it must be a number of steps above 0: {_CURE}")
    return int(steps)


def _timestamps(metadata: Mapping[str, Any], steps: int) -> np.ndarray:
    for name in ("ts", "timestep"):
        if metadata.get(name) is not None:
            return _numbers(metadata[name], (steps,), f"metadata.{name}")
    return _DEFAULT_STEP * np.arange(steps)


def _object_type(track: Mapping[str, Any], states: _TrackStates, unknown: Counter[str]) -> int:
    word = str(track.get("type", "unset"))
    agent_type = look_up(OBJECT_WORDS, word, OTHER_OBJECT, "object type", unknown)
    if agent_type == BICYCLE:
        speeds = np.hypot(*states.velocities[states.valid].T)
        agent_type = AgentType.CYCLIST if speeds.size and np.median(speeds) > 1.0 else AgentType.STATIC
    return int(agent_type)


def _is_lane(feature: Mapping[str, Any]) -> bool:
    word = canonical(str(feature.get("type", "")))
    return word.startswith("lane_") or word in ("surface_street", "freeway", "bike_lane", "bus_lane")


def _feature_lane(name: str, feature: Mapping[str, Any], unknown: Counter[str], has_elevation: bool) -> MapLane:
    points = _numbers(feature.get("polyline"), (-1, 3), f"map_features[{name}].polyline")
    if not has_elevation or np.isnan(points[:, 2]).any():
        points[:, 2] = np.nan
    return MapLane(
        id=name,
        lane_type=look_up(LANE_WORDS, str(feature.get("type")), None, "lane type", unknown),
        points=points,
        predecessors=_ids(feature.get("entry_lanes")),
        successors=_ids(feature.get("exit_lanes")),
        left_neighbors=_feature_neighbors(feature.get("left_neighbor")),
        right_neighbors=_feature_neighbors(feature.get("right_neighbor")),
    )


def _ids(values: Any) -> tuple[str, ...]:
    return tuple(map(str, values)) if isinstance(values, list | tuple | np.ndarray) else ()


def _feature_neighbors(values: Any) -> tuple[LaneNeighbor, ...]:
    neighbors = []
    for item in values if isinstance(values, list | tuple) else ():
        if isinstance(item, Mapping) and "feature_id" in item:
            span = [item.get(key) for key in _NEIGHBOR_KEYS]
            indices = [int(index) if isinstance(index, int | np.integer) else None for index in span]
            neighbors.append(LaneNeighbor(str(item["feature_id"]), *(indices if None not in indices else ())))
        elif isinstance(item, str | int | np.integer):
            neighbors.append(LaneNeighbor(str(item)))
    return tuple(neighbors)


def _lights(lights: Mapping[Any, Any], steps: int, unknown: Counter[str]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Lane id -> states at every step and stop point [m]."""
    rows = {}
    for name, light in lights.items():
        light = _mapping(light, f"dynamic_map_states[{name}]")
        state = _mapping(light.get("state", {}), f"dynamic_map_states[{name}].state")
        words = state.get("object_state", [])
        if not isinstance(words, list | tuple | np.ndarray) or len(words) != steps:
            raise ValueError(f"dynamic_map_states[{name}].state.object_state has not one word for each step: {_CURE}")
        states = [
            Signal.UNKNOWN
            if word is None
            else look_up(SIGNAL_WORDS, str(word), Signal.UNKNOWN, "signal state", unknown)
            for word in words
        ]
        stop = light.get("stop_point")
        point = np.full(3, np.nan)
        if stop is not None and np.asarray(stop).size in (2, 3):
            point[: np.asarray(stop).size] = _numbers(stop, (-1,), f"dynamic_map_states[{name}].stop_point")
        rows[str(light.get("lane", name))] = (np.array(states, np.int8), point)
    return rows


def _mapping(value: Any, name: str) -> Mapping[Any, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} is {type(value).__name__}, not a dict: {_CURE}")
    return value


def _numbers(value: Any, shape: tuple[int, ...], name: str) -> np.ndarray:
    """Numbers of this shape as a float64 array of its own; -1 stands for any length, and two columns may lack z."""
    if isinstance(value, list | tuple):
        flat = all(isinstance(item, int | float | np.number) for item in value)
        if not flat and not all(isinstance(item, list | tuple | np.ndarray) and len(item) <= 3 for item in value):
            raise ValueError(f"{name} is no list of numbers or points: {_CURE}")
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} holds no numbers ({error}): {_CURE}") from error
    if shape[-1:] == (3,) and array.ndim == 2 and array.shape[1] == 2:
        array = np.concatenate([array, np.full((len(array), 1), np.nan)], 1)
    if array.ndim == len(shape) + 1 and array.shape[-1] == 1:
        array = array[..., 0]
    if array.ndim != len(shape) or any(size not in (-1, own) for size, own in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{name} has the shape {array.shape}, not {shape}: {_CURE}")
    return array


def _is_pickle(head: bytes) -> bool:
    return head[:1] == b"\x80"


SCENARIONET = FileFormat("ScenarioNet", "*.pkl", "", _is_pickle, read_scenarionet, names_location=True)
