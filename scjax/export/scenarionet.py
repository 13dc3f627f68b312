"""ScenarioNet: a folder of scenarios that MetaDrive replays.

The folder holds a pickle for each scenario, and two tables of them: ``dataset_summary.pkl`` and
``dataset_mapping.pkl``. A further scenario is added to the tables; one of the same name replaces the one before.
Pickles hold plain containers and NumPy arrays only, and need NumPy 1.26 or newer.
"""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np

from scjax.data.readers.restricted_pickle import load_plain_pickle
from scjax.export.base import Export, Losses
from scjax.export.roads.lane_network import LaneBeside, LaneNetwork, border_line, index_at, lane_network
from scjax.export.traffic import LANE_WIDTH, filled_traffic, log_with_ego
from scjax.scene import OTHER_OBJECT, AgentType, Log, Signal
from scjax.scene.files import read_limited, write_file

VERSION = "scjax-1"
"""Version of the content, in the names of the files."""

_SUMMARY, _MAPPING = "dataset_summary.pkl", "dataset_mapping.pkl"
_TYPES = {
    AgentType.VEHICLE: "VEHICLE",
    AgentType.PEDESTRIAN: "PEDESTRIAN",
    AgentType.CYCLIST: "CYCLIST",
    AgentType.STATIC: "TRAFFIC_BARRIER",
    OTHER_OBJECT: "OTHER",
}
_LIGHTS = {
    Signal.UNKNOWN: "TRAFFIC_LIGHT_UNKNOWN",
    Signal.GO: "TRAFFIC_LIGHT_GREEN",
    Signal.CAUTION: "TRAFFIC_LIGHT_YELLOW",
    Signal.STOP: "TRAFFIC_LIGHT_RED",
}
_LANE_TYPES = {"freeway": "LANE_FREEWAY", "bike_lane": "LANE_BIKE_LANE", None: "LANE_UNKNOWN"}
_CAR_LANE = "LANE_SURFACE_STREET"


def write_scenarionet(log: Log, folder: Path, losses: Losses) -> tuple[Path, ...]:
    """Adds ``log`` to a ScenarioNet folder, which is made if it is missing.

    Raises:
      ValueError: the log has no lane or no vehicle, or the tables of the folder cannot be read.
    """
    if folder.is_file():
        raise ValueError(f"{folder} is a file: ScenarioNet scenarios are written to a folder, give its name")
    scenario = scenario_content(log, losses)
    domain, name = (_file_word(word) for word in (log.metadata.domain or "scjax", scenario["id"]))
    path = folder / f"sd_{domain}_{VERSION}_{name}.pkl"
    summary, mapping = _read_table(folder / _SUMMARY), _read_table(folder / _MAPPING)
    summary[path.name] = _summary(scenario)
    mapping[path.name] = ""
    paths = (path, folder / _SUMMARY, folder / _MAPPING)
    for target, content in zip(paths, (scenario, summary, mapping), strict=True):
        write_file(target, lambda file, content=content: pickle.dump(content, file, protocol=4))
    return paths


def scenario_content(log: Log, losses: Losses) -> dict[str, Any]:
    """The dict of a scenario as ScenarioNet defines it.

    Raises:
      ValueError: the log has no lane or no vehicle.
    """
    log = filled_traffic(log_with_ego(log, losses, "MetaDrive"), losses)
    network = lane_network(log, losses)
    losses["lanes of a type that MetaDrive lacks, written as lanes for cars"] += sum(
        lane.lane_type not in (*_LANE_TYPES, "surface_street") for lane in network.lanes
    )
    known = {lane.id for lane in network.lanes}
    losses["signals of lanes that are not there, left out"] += sum(lane not in known for lane in log.signal_lane_ids)
    name = log.metadata.scene_id or "scene"
    ego = log.object_ids[log.ego_index]
    dataset = log.metadata.domain or "scjax"
    return {
        "id": name,
        "version": VERSION,
        "length": log.num_steps,
        "metadata": {
            "ts": log.timestamps - log.timestamps[0],
            "metadrive_processed": False,
            "coordinate": "right-handed",
            "sdc_id": ego,
            "scenario_id": name,
            "dataset": dataset,
            "id": name,
            "source_file": log.metadata.source_file,
            "track_length": log.num_steps,
        },
        "tracks": {name: _track(log, row, dataset) for row, name in enumerate(log.object_ids)},
        "dynamic_map_states": {
            lane: _light(log, row, network) for row, lane in enumerate(log.signal_lane_ids) if lane in known
        },
        "map_features": {lane.id: _feature(network, row) for row, lane in enumerate(network.lanes)},
    }


def _track(log: Log, row: int, dataset: str) -> dict[str, Any]:
    kind, name = _TYPES[int(log.object_types[row])], log.object_ids[row]
    valid = log.valid[row]
    length, width, height = (np.where(valid, size, 0.0).astype(np.float32) for size in log.sizes[row])
    return {
        "type": kind,
        "state": {
            "position": log.positions[row].astype(np.float64),
            "heading": log.headings[row].astype(np.float64),
            "velocity": log.velocities[row].astype(np.float64),
            "length": length,
            "width": width,
            "height": height,
            "valid": valid.copy(),
        },
        "metadata": {"type": kind, "object_id": name, "track_length": log.num_steps, "dataset": dataset},
    }


def _light(log: Log, row: int, network: LaneNetwork) -> dict[str, Any]:
    lane = log.signal_lane_ids[row]
    line = next(line for item, line in zip(network.lanes, network.lines, strict=True) if item.id == lane)
    place = np.where(np.isnan(log.signal_positions[row]), line[0], log.signal_positions[row])
    return {
        "type": "TRAFFIC_LIGHT",
        "lane": lane,
        "stop_point": place.astype(np.float64),
        "state": {"object_state": [_LIGHTS[Signal(state)] for state in log.signal_states[row].tolist()]},
        "metadata": {"type": "TRAFFIC_LIGHT", "object_id": lane, "track_length": log.num_steps, "dataset": ""},
    }


def _feature(network: LaneNetwork, row: int) -> dict[str, Any]:
    lane, line = network.lanes[row], network.lines[row]
    left, right = border_line(line, LANE_WIDTH / 2), border_line(line, -LANE_WIDTH / 2)
    return {
        "type": _LANE_TYPES.get(lane.lane_type, _CAR_LANE),
        "polyline": line,
        "polygon": np.concatenate([left, right[::-1]])[:, :2],
        "width": np.full((len(line), 2), LANE_WIDTH / 2),
        "entry_lanes": [network.lanes[j].id for j in network.predecessors[row]],
        "exit_lanes": [network.lanes[j].id for j in network.successors[row]],
        "left_neighbor": [_neighbor(network, row, beside) for beside in network.left[row]],
        "right_neighbor": [_neighbor(network, row, beside) for beside in network.right[row]],
    }


def _neighbor(network: LaneNetwork, row: int, beside: LaneBeside) -> dict[str, Any]:
    own, other = network.lines[row], network.lines[beside.lane]
    return {
        "feature_id": network.lanes[beside.lane].id,
        "self_start_index": index_at(own, beside.own[0]),
        "self_end_index": index_at(own, beside.own[1]),
        "neighbor_start_index": index_at(other, beside.other[0]),
        "neighbor_end_index": index_at(other, beside.other[1]),
    }


def _summary(scenario: dict[str, Any]) -> dict[str, Any]:
    """The row of a scenario in the table of its folder."""
    tracks = scenario["tracks"]
    kinds = [track["type"] for track in tracks.values()]
    ego = tracks[scenario["metadata"]["sdc_id"]]["state"]["position"]
    return {
        **scenario["metadata"],
        "object_summary": {
            name: {
                "type": track["type"],
                "object_id": name,
                "track_length": len(track["state"]["valid"]),
                "valid_length": int(track["state"]["valid"].sum()),
                "moving_distance": _moved_distance(track["state"]),
            }
            for name, track in tracks.items()
        },
        "number_summary": {
            "num_objects": len(kinds),
            "object_types": sorted(set(kinds)),
            "num_objects_each_type": {kind: kinds.count(kind) for kind in sorted(set(kinds))},
            "num_traffic_lights": len(scenario["dynamic_map_states"]),
            "num_map_features": len(scenario["map_features"]),
            "sdc_distance": float(np.hypot(*np.diff(ego[:, :2], axis=0).T).sum()),
        },
    }


def _moved_distance(state: dict[str, Any]) -> float:
    places = state["position"][state["valid"], :2]
    return float(np.hypot(*np.diff(places, axis=0).T).sum())


def _read_table(path: Path) -> dict[str, Any]:
    """A table of a folder; empty if it is missing."""
    if not path.is_file():
        return {}
    try:
        table = load_plain_pickle(read_limited(path))
    except ValueError as error:
        raise ValueError(f"{path}: {error}: give an empty folder") from error
    if not isinstance(table, dict):
        raise ValueError(f"{path}: holds no table of scenarios: give an empty folder")
    return _plain(table)


def _plain(value: Any) -> Any:
    """Containers with arrays of NumPy's own class, which other programs can read."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(map(_plain, value))
    return np.array(value, subok=False) if isinstance(value, np.ndarray) else value


def _file_word(text: str) -> str:
    return re.sub(r"[^\w.-]+", "-", text)[:80] or "scene"


SCENARIONET_EXPORT = Export("ScenarioNet", "", "MetaDrive, ScenarioNet", write_scenarionet)
