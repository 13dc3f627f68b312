"""GPUDrive and PufferDrive: one scene as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from scjax.export.base import Export, Losses
from scjax.export.roads.lane_network import lane_network
from scjax.export.roads.road_edges import road_edges
from scjax.export.traffic import filled_traffic, log_with_ego
from scjax.scene import OTHER_OBJECT, AgentType, Log, Signal
from scjax.scene.files import write_text

MAX_OBJECTS, MAX_ROADS, MAX_ROAD_POINTS, MAX_STEPS = 64, 10_000, 1810, 91
"""What the simulator takes of one scene."""

_TYPES = {AgentType.VEHICLE: "vehicle", AgentType.PEDESTRIAN: "pedestrian", AgentType.CYCLIST: "cyclist"}
_MAP_IDS = {"freeway": 1, "bike_lane": 3}  # of the Waymo map format
_STREET_ID, _EDGE_ID = 2, 15
_STATES = {Signal.UNKNOWN: "unknown", Signal.GO: "go", Signal.CAUTION: "caution", Signal.STOP: "stop"}
_MOVED = 2.0  # m between the first and the last place of an object that has a goal
_ABSENT = -10_000.0  # position at steps without an observation


def write_gpudrive(log: Log, path: Path, losses: Losses) -> tuple[Path, ...]:
    """Writes ``log`` as a scene of GPUDrive.

    Raises:
      ValueError: the log has no lane or no vehicle.
    """
    write_text(path, json.dumps(gpudrive_content(log, losses, path.name), allow_nan=False))
    return (path,)


def gpudrive_content(log: Log, losses: Losses, name: str) -> dict[str, Any]:
    """The scene as JSON values."""
    log = filled_traffic(log_with_ego(log, losses, "GPUDrive"), losses)
    losses[f"steps after the first {MAX_STEPS}, which the simulator does not read"] += max(log.num_steps - MAX_STEPS, 0)
    network = lane_network(log, losses)
    rows = _written_objects(log, losses)
    moving = [number for number, row in enumerate(rows) if _distance(log, row) > _MOVED]
    roads = [
        {
            "geometry": _points(line),
            "type": "lane",
            "id": number,
            "map_element_id": _MAP_IDS.get(lane.lane_type or "", _STREET_ID),
        }
        for number, (lane, line) in enumerate(zip(network.lanes, network.lines, strict=True))
    ]
    for edge in road_edges(network, losses):
        roads.append({"geometry": _points(edge), "type": "road_edge", "id": len(roads), "map_element_id": _EDGE_ID})
    losses["connections and neighbors of lanes, left out"] += len(network.pairs) + sum(map(len, network.left))
    losses[f"roads beyond {MAX_ROADS}, which the simulator does not read"] += max(len(roads) - MAX_ROADS, 0)
    losses[f"roads of more than {MAX_ROAD_POINTS} points, which the simulator does not read whole"] += sum(
        len(road["geometry"]) > MAX_ROAD_POINTS for road in roads
    )
    return {
        "name": name,
        "scenario_id": log.metadata.scene_id or "scene",
        "objects": [_object(log, row, number) for number, row in enumerate(rows)],
        "roads": roads,
        "tl_states": _lights(log),
        "metadata": {
            "sdc_track_index": 0,
            "tracks_to_predict": [{"track_index": number, "difficulty": 0} for number in moving],
            "objects_of_interest": [],
        },
    }


def _written_objects(log: Log, losses: Losses) -> list[int]:
    """The ego, then the others from near to far; the format has vehicles, pedestrians and cyclists alone."""
    known = np.isin(log.object_types, list(_TYPES))
    losses["static objects, left out"] += int((log.object_types == AgentType.STATIC).sum())
    losses["objects of no class, left out"] += int((log.object_types == OTHER_OBJECT).sum())
    ego = log.positions[log.ego_index, :, :2]
    distance = np.where(log.valid, np.hypot(*(log.positions[..., :2] - ego).T).T, np.inf).min(1)
    distance[log.ego_index] = -1.0
    rows = [row for row in np.argsort(distance, kind="stable").tolist() if known[row]]
    losses[f"objects beyond {MAX_OBJECTS}, which the simulator does not read"] += max(len(rows) - MAX_OBJECTS, 0)
    return rows


def _distance(log: Log, row: int) -> float:
    places = log.positions[row, log.valid[row], :2]
    return float(np.hypot(*(places[-1] - places[0])))


def _object(log: Log, row: int, number: int) -> dict[str, Any]:
    valid = log.valid[row]
    length, width, height = log.sizes[row].tolist()
    positions = np.where(valid[:, None], log.positions[row], _ABSENT)
    goal = log.positions[row, np.flatnonzero(valid)[-1]]
    return {
        "position": _points(positions),
        "width": width,
        "length": length,
        "height": height,
        "id": number,
        "heading": np.angle(np.exp(1j * log.headings[row])).tolist(),
        "velocity": [{"x": x, "y": y} for x, y in log.velocities[row].tolist()],
        "valid": valid.tolist(),
        "goalPosition": _points(goal[None])[0],
        "type": _TYPES[AgentType(int(log.object_types[row]))],
        "mark_as_expert": False,
    }


def _points(line: np.ndarray) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "z": z} for x, y, z in line.tolist()]


def _lights(log: Log) -> dict[str, Any]:
    """States of the lights by lane, as in files made of Waymo's data."""
    steps = list(range(log.num_steps))
    lights = {}
    for lane, states, place in zip(log.signal_lane_ids, log.signal_states, log.signal_positions, strict=True):
        x, y, z = np.nan_to_num(place).tolist()
        lights[lane] = {
            "state": [_STATES[Signal(state)] for state in states.tolist()],
            "x": [x] * len(steps),
            "y": [y] * len(steps),
            "z": [z] * len(steps),
            "time_index": steps,
            "lane_id": [lane] * len(steps),
        }
    return lights


GPUDRIVE_EXPORT = Export("GPUDrive JSON", ".json", "GPUDrive, PufferDrive", write_gpudrive)
