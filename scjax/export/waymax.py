"""Waymax: the arrays of its ``SimulatorState`` as .npz, one per field, with dots in their names.

``dict(numpy.load(file))`` gives "log_trajectory.x" and so on; a state is made of them without conversion. The
simulated trajectory of a new state is the log's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scjax.export.base import Export, Losses
from scjax.export.roads.lane_network import LaneNetwork, lane_network
from scjax.export.roads.road_edges import road_edges
from scjax.export.traffic import filled_traffic, log_with_ego
from scjax.scene import AgentType, Log, Signal
from scjax.scene.files import write_file
from scjax.scene.polyline import cumulative_length, spread_points

MAX_SPACING = 0.5
"""Distance between points of the road graph [m]."""

INIT_STEPS = 10
"""Step at which Waymax takes over, if the log is longer."""

_TYPES = {AgentType.VEHICLE: 1, AgentType.PEDESTRIAN: 2, AgentType.CYCLIST: 3}
_OTHER_TYPE = 4
_LIGHTS = {Signal.UNKNOWN: 0, Signal.STOP: 4, Signal.CAUTION: 5, Signal.GO: 6}
_LANES = {"freeway": 1, "bike_lane": 3}
_STREET, _EDGE = 2, 15
_Arrays = dict[str, np.ndarray]


def write_waymax(log: Log, path: Path, losses: Losses) -> tuple[Path, ...]:
    """Writes ``log`` as the arrays of a simulator state.

    Raises:
      ValueError: the log has no lane or no vehicle.
    """
    arrays = waymax_arrays(log, losses)
    write_file(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))  # pyright: ignore
    return (path,)


def waymax_arrays(log: Log, losses: Losses) -> _Arrays:
    """Field of ``SimulatorState`` -> its values."""
    log = filled_traffic(log_with_ego(log, losses, "Waymax"), losses)
    losses["static objects, written as of another type"] += int((log.object_types == AgentType.STATIC).sum())
    network = lane_network(log, losses)
    losses["connections and neighbors of lanes, left out"] += len(network.pairs) + sum(map(len, network.left))
    arrays = {
        **_prefixed("log_trajectory", _trajectory(log)),
        **_prefixed("log_traffic_light", _lights(log, network)),
        **_prefixed("object_metadata", _objects(log)),
        **_prefixed("roadgraph_points", _road_graph(network, losses)),
        **_prefixed("sdc_paths", _ego_path(log)),
        "timestep": np.array(min(INIT_STEPS, log.num_steps - 1), np.int32),
    }
    return arrays


def _prefixed(name: str, arrays: _Arrays) -> _Arrays:
    return {f"{name}.{field}": values for field, values in arrays.items()}


def _trajectory(log: Log) -> _Arrays:
    """[objects, steps] each."""
    shape = log.valid.shape
    micros = np.round((log.timestamps - log.timestamps[0]) * 1e6).astype(np.int32)
    columns = {
        **dict(zip("xyz", np.moveaxis(log.positions, -1, 0), strict=True)),
        "vel_x": log.velocities[..., 0],
        "vel_y": log.velocities[..., 1],
        "yaw": log.headings,
        **{
            name: np.where(log.valid, log.sizes[:, k : k + 1], 0.0)
            for k, name in enumerate(("length", "width", "height"))
        },
    }
    arrays = {name: values.astype(np.float32) for name, values in columns.items()}
    return arrays | {"valid": log.valid.copy(), "timestamp_micros": np.broadcast_to(micros, shape).copy()}


def _lights(log: Log, network: LaneNetwork) -> _Arrays:
    """[signals, steps] each. Lanes have their index as id."""
    shape = log.signal_states.shape
    rows = {lane.id: row for row, lane in enumerate(network.lanes)}
    ids = np.array([rows.get(lane, -1) for lane in log.signal_lane_ids], np.int32)
    states = np.array([_LIGHTS[Signal(state)] for state in log.signal_states.reshape(-1).tolist()], np.int32)
    starts = np.array([network.lines[row][0] if row >= 0 else np.zeros(3) for row in ids.tolist()]).reshape(-1, 3)
    places = np.where(np.isnan(log.signal_positions), starts, log.signal_positions)
    arrays = {
        name: np.broadcast_to(places[:, k : k + 1].astype(np.float32), shape).copy() for k, name in enumerate("xyz")
    }
    return arrays | {
        "state": states.reshape(shape),
        "lane_ids": np.broadcast_to(ids[:, None], shape).copy(),
        "valid": np.broadcast_to((ids >= 0)[:, None], shape).copy(),
    }


def _objects(log: Log) -> _Arrays:
    """[objects] each. Ids count the objects, since those of a log are texts."""
    count = log.num_objects
    types = [_TYPES.get(AgentType(kind), _OTHER_TYPE) if kind >= 0 else _OTHER_TYPE for kind in log.object_types]
    is_ego = np.asarray(np.arange(count) == log.ego_index)
    observed = np.asarray(log.valid.any(axis=1))
    moves = np.asarray((np.asarray(types) != _OTHER_TYPE) & observed)
    return {
        "ids": np.arange(count, dtype=np.int32),
        "object_types": np.array(types, np.int32),
        "is_sdc": is_ego,
        "is_modeled": moves,
        "is_valid": observed,
        "objects_of_interest": np.zeros(count, bool),
        "is_controlled": moves,
    }


def _road_graph(network: LaneNetwork, losses: Losses) -> _Arrays:
    """[points] each: centerlines of lanes, then edges of the road. Ids count the lines."""
    lines = [spread_points(line, MAX_SPACING) for line in network.lines]
    types = [_LANES.get(lane.lane_type or "", _STREET) for lane in network.lanes]
    for edge in road_edges(network, losses):
        lines.append(spread_points(edge, MAX_SPACING))
        types.append(_EDGE)
    counts = [len(line) for line in lines]
    points = np.concatenate(lines)
    steps = np.concatenate([np.diff(line, axis=0, append=line[-1:]) for line in lines])
    for end in np.cumsum(counts) - 1:
        steps[end] = steps[end - 1]  # the last point of a line has the direction before it
    units = steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-9)
    arrays = {name: points[:, k].astype(np.float32) for k, name in enumerate("xyz")}
    arrays |= {f"dir_{name}": units[:, k].astype(np.float32) for k, name in enumerate("xyz")}
    return arrays | {
        "types": np.repeat(np.array(types, np.int32), counts),
        "ids": np.repeat(np.arange(len(lines), dtype=np.int32), counts),
        "valid": np.ones(len(points), bool),
    }


def _ego_path(log: Log) -> _Arrays:
    """[paths, points] each: the way that the ego takes, as the one path."""
    places = log.positions[log.ego_index]
    moved = np.append(True, np.hypot(*np.diff(places[:, :2], axis=0).T) > 1e-3)
    path = places[moved]
    arrays = {name: path[None, :, k].astype(np.float32) for k, name in enumerate("xyz")}
    return arrays | {
        "ids": np.zeros((1, len(path)), np.int32),
        "valid": np.ones((1, len(path)), bool),
        "arc_length": cumulative_length(path)[None].astype(np.float32),
        "on_route": np.ones((1, 1), bool),
    }


WAYMAX_EXPORT = Export("Waymax arrays", ".npz", "Waymax", write_waymax)
