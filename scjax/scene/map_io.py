"""Maps in files: ``.npz`` (exact, fast) and JSON (readable, writable by hand)."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct

from scjax.scene.document import parse_document
from scjax.scene.files import read_limited, write_file, write_text
from scjax.scene.lane_io import LANE_ARRAYS, LaneHeader, pack_lanes, unpack_lanes
from scjax.scene.log import LogMetadata
from scjax.scene.map import Map, MapRoute, MapSeam, MapTile, validate_map
from scjax.scene.npz import read_npz
from scjax.scene.scene import STATE_COLUMNS, AgentType, Signal
from scjax.scene.scene_document import FileVersion

MAP_FORMAT, MAP_VERSION = "scjax-map", 1
_CURE = "write it with scjax.scene.save_map"
_DIGITS = 6  # of meters and radians in JSON
_ARRAYS = {
    "signal_states": "i",
    "signal_positions": "f",
    "agent_types": "i",
    "agents": "f",
    **LANE_ARRAYS,
}

Number = float | None
Point = Annotated[list[Number], Meta(min_length=2, max_length=3)]


class MapHeader(Struct):
    """All of a map that is not numbers, in npz files."""

    signal_lane_ids: tuple[str, ...]
    agent_ids: tuple[str, ...]
    has_topology: bool
    lanes: list[LaneHeader]
    tiles: tuple[MapTile, ...]
    seams: tuple[MapSeam, ...]
    routes: tuple[MapRoute, ...]
    metadata: LogMetadata


class MapLaneRow(LaneHeader, kw_only=True, forbid_unknown_fields=True):
    """One lane with its points [x, y] or [x, y, z] in driving direction [m]; z is null where it is not known."""

    points: Annotated[list[Point], Meta(min_length=1)]


class MapSignalRow(Struct, forbid_unknown_fields=True):
    """The signal that controls a lane, and its stop point [m]."""

    lane_id: str
    state: Literal["unknown", "go", "caution", "stop"] = "unknown"
    position: Annotated[tuple[Number, ...], Meta(max_length=3)] = ()


class MapAgentRow(Struct, forbid_unknown_fields=True):
    """One agent: box center and size [m], speed [m/s], heading [rad]; null or absent where not known."""

    id: str
    type: Literal["vehicle", "pedestrian", "cyclist", "static"]
    x: float
    y: float
    heading: float
    z: Number = None
    speed: Number = None
    length: Number = None
    width: Number = None
    height: Number = None


class MapFile(Struct, forbid_unknown_fields=True):
    """A map in JSON. All but ``format``, ``version`` and ``lanes`` may be left out."""

    format: Literal["scjax-map"]
    version: Literal[1]
    lanes: list[MapLaneRow]
    has_topology: bool = True
    signals: list[MapSignalRow] = []
    agents: list[MapAgentRow] = []
    tiles: tuple[MapTile, ...] = ()
    seams: tuple[MapSeam, ...] = ()
    routes: tuple[MapRoute, ...] = ()
    metadata: LogMetadata = LogMetadata()


def save_map(map: Map, path: str | Path) -> None:
    """Writes ``map`` to a temporary name first: exactly, or rounded to 1e-6 if ``path`` ends in .json.

    Raises:
      ValueError: the map breaks an invariant (``validate_map``), or the name ends neither in .npz nor in .json.
    """
    path = Path(path)
    if path.suffix not in (".npz", ".json"):
        raise ValueError(f"{path}: maps are written to .npz or .json files: choose one of these endings")
    validate_map(map)
    if path.suffix == ".json":
        write_text(path, _text_of(map))
        return
    lanes, arrays = pack_lanes(map.lanes)
    header: dict[str, Any] = {name: getattr(map, name) for name in ("signal_lane_ids", "agent_ids", "has_topology")}
    header |= {"format": MAP_FORMAT, "version": MAP_VERSION, "lanes": lanes} | _planning(map)
    arrays |= {name: getattr(map, name) for name in _ARRAYS if name not in LANE_ARRAYS}
    fields: dict[str, Any] = {"header": json.dumps(header), **arrays}
    write_file(path, lambda file: np.savez_compressed(file, allow_pickle=False, **fields))


def load_map(path: str | Path) -> Map:
    """Reads what ``save_map`` wrote; ``scjax.data.imports.import_map`` also reads the formats of others.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: on a damaged file, another version, missing fields or an invalid map; names the file.
    """
    path = Path(path)
    map = _load_json(path) if path.suffix == ".json" else _load_npz(path)
    try:
        return validate_map(map)
    except ValueError as error:
        raise ValueError(f"{path} holds an invalid map: {error}") from error


def _load_npz(path: Path) -> Map:
    arrays = read_npz(path, {"header": "U", **_ARRAYS}, _CURE, optional=frozenset({"header", *_ARRAYS}))
    text = str(arrays.pop("header", "{}"))
    _check_map_version(parse_document(text, FileVersion, f"{path}, header", _CURE), path)
    if missing := sorted(set(_ARRAYS) - set(arrays)):
        raise ValueError(f"{path} lacks the arrays {missing}: {_CURE}")
    header = parse_document(text, MapHeader, f"{path}, header", _CURE)
    try:
        return Map(
            lanes=unpack_lanes(header.lanes, arrays),
            has_topology=header.has_topology,
            signal_lane_ids=header.signal_lane_ids,
            signal_states=arrays["signal_states"],
            signal_positions=arrays["signal_positions"],
            agent_ids=header.agent_ids,
            agent_types=arrays["agent_types"],
            agents=arrays["agents"],
            tiles=header.tiles,
            seams=header.seams,
            routes=header.routes,
            metadata=header.metadata,
        )
    except (ValueError, TypeError) as error:  # arrays of other numbers of axes
        raise ValueError(f"{path} holds an invalid map: {error}") from error


def _load_json(path: Path) -> Map:
    data = read_limited(path)
    _check_map_version(parse_document(data, FileVersion, path, _CURE), path)
    content = parse_document(data, MapFile, path, _CURE)
    return Map(
        lanes=tuple(lane.with_points(_point_rows(lane.points)) for lane in content.lanes),
        has_topology=content.has_topology,
        signal_lane_ids=tuple(row.lane_id for row in content.signals),
        signal_states=np.array([Signal[row.state.upper()] for row in content.signals], np.int32),
        signal_positions=_point_rows([row.position for row in content.signals]),
        agent_ids=tuple(row.id for row in content.agents),
        agent_types=np.array([AgentType[row.type.upper()] for row in content.agents], np.int32),
        agents=np.array([_agent_columns(row) for row in content.agents], np.float64).reshape(-1, len(STATE_COLUMNS)),
        tiles=content.tiles,
        seams=content.seams,
        routes=content.routes,
        metadata=content.metadata,
    )


def _check_map_version(header: FileVersion, path: Path) -> None:
    if header.format != MAP_FORMAT:
        raise ValueError(f"{path} is no map: {_CURE}")
    if header.version != MAP_VERSION:
        raise ValueError(f"{path} has format version {header.version!r}, this scjax reads {MAP_VERSION}: update")


def _point_rows(points: Sequence[Sequence[Number]]) -> np.ndarray:
    rows = np.full((len(points), 3), np.nan)
    for row, point in zip(rows, points, strict=True):
        row[: len(point)] = point
    return rows


def _agent_columns(row: MapAgentRow) -> list[Number]:
    direction = [float(np.cos(row.heading)), float(np.sin(row.heading))]
    return [row.x, row.y, row.z, row.speed, *direction, row.length, row.width, row.height]


def _planning(map: Map) -> dict[str, Any]:
    """Tiles, seams, routes and metadata as values of JSON."""
    fields = {name: getattr(map, name) for name in ("tiles", "seams", "routes")}
    return msgspec.to_builtins(fields | {"metadata": dataclasses.asdict(map.metadata)}, enc_hook=_plain_number)


def _plain_number(value: Any) -> Any:
    """A number of NumPy as one of Python."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} cannot be written")


def _text_of(map: Map) -> str:
    """A map as text: one line for each lane, signal and agent."""
    headers = pack_lanes(map.lanes)[0]
    lanes = [
        {
            **{name: value for name, value in header.items() if value},
            "points": [_numbers(point) for point in lane.points],
        }
        for header, lane in zip(headers, map.lanes, strict=True)
    ]
    signals = [
        {"lane_id": lane_id, "state": Signal(int(state)).name.lower(), "position": _numbers(position)}
        for lane_id, state, position in zip(map.signal_lane_ids, map.signal_states, map.signal_positions, strict=True)
    ]
    agents = []
    for name, agent_type, row in zip(map.agent_ids, map.agent_types, map.agents, strict=True):
        values = dict(zip(STATE_COLUMNS, _numbers(row), strict=True)) | {"heading": float(np.arctan2(row[5], row[4]))}
        kept = {key: value for key, value in values.items() if key not in ("cos", "sin")}
        agents.append({"id": name, "type": AgentType(int(agent_type)).name.lower(), **kept})
    planning = _planning(map)
    rows = {"lanes": lanes, "signals": signals, "agents": agents, **planning}
    head = {"format": MAP_FORMAT, "version": MAP_VERSION, "has_topology": map.has_topology}
    lists = ",\n ".join(f'"{key}": {_rows_text(value)}' for key, value in rows.items())
    return f"{json.dumps(head)[:-1]},\n {lists}}}\n"


def _rows_text(value: Any) -> str:
    if isinstance(value, dict):
        return json.dumps(value)
    return "[" + ",".join(f"\n  {json.dumps(row)}" for row in value) + "]"


def _numbers(values: np.ndarray) -> list[Number]:
    """Rounded values; None for NaN."""
    return [None if np.isnan(value) else round(float(value), _DIGITS) for value in values]
