"""A map: lanes, signals and agents of one moment in one frame, of any extent, and the tiles that they came from.

A ``Map`` has no time: ``Log`` is the type with time, and holds lanes of the same kind. ``Scene`` is a window of a map,
padded for networks (``scjax.data.map_crop.crop_map``). Files that people have become maps (``scjax.data.imports``).
"""

from __future__ import annotations

import dataclasses
import enum
import functools
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene.checks import check_known, check_range, check_unique
from scjax.scene.limits import MAX_COORDINATE
from scjax.scene.log import LogMetadata
from scjax.scene.map_lane import MapLane, check_lanes
from scjax.scene.scene import STATE_COLUMNS, TILE_SIZE, AgentType, Signal


class TileStatus(enum.Enum):
    """What is known of a tile."""

    KNOWN = "known"  # it was there before anything was generated: a file, a recording, a scene
    COMPLETE = "complete"  # generated, and every check holds
    INCOMPLETE = "incomplete"  # generated and kept, although a check fails
    MISSING = "missing"  # no candidate could be kept: the window is empty


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapTile:
    """A square window of 64 m x 64 m that was added to a map as a whole.

    Attributes:
      x, y, z: its center [m].
      yaw: direction of its x axis [rad].
      status: what is known of it.
      attempts: candidates that were generated for it.
      prompt: text that it was generated for.
      fault: why it is not complete; empty if it is.
      lane_ids, agent_ids: what came with it.
    """

    x: float
    y: float
    z: float = 0.0
    yaw: float = 0.0
    status: TileStatus = TileStatus.KNOWN
    attempts: int = 0
    prompt: str = ""
    fault: str = ""
    lane_ids: tuple[str, ...] = ()
    agent_ids: tuple[str, ...] = ()

    @property
    def corners(self) -> Float64[np.ndarray, "4 2"]:
        """Corners of the window [m], counter-clockwise from the rear right."""
        half = TILE_SIZE / 2
        square = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return square @ np.array([[cos, sin], [-sin, cos]]) + np.array([self.x, self.y])


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapSeam:
    """Where a tile was joined to another one.

    Attributes:
      tiles: indices of the older and the newer tile.
      start, end: x, y of both ends of the line on which they meet [m].
      connections: pairs of lane ids, the second follows the first, each in one of the two tiles.
    """

    tiles: tuple[int, int]
    start: tuple[float, float]
    end: tuple[float, float]
    connections: tuple[tuple[str, str], ...] = ()


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapRoute:
    """A way over a map.

    Attributes:
      lane_ids: lanes in order; each follows the one before, or lies beside it.
      start: where it begins on the first lane, in xy arc length [m].
      end: where it ends on the last lane [m]; None for the lane's end.
      name: empty, or what it is for.
    """

    lane_ids: tuple[str, ...]
    start: float = 0.0
    end: float | None = None
    name: str = ""


_NO_WORDS = functools.partial(np.zeros, 0, np.int32)
_NO_POINTS = functools.partial(np.zeros, (0, 3))
_NO_STATES = functools.partial(np.zeros, (0, len(STATE_COLUMNS)))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Map:
    """L lanes, S signals and N agents at one moment, as NumPy arrays in SI units on the host.

    The frame is any right-handed one with z up, such as that of a file; arrays are float64, since coordinates may be
    tens of kilometers. All fields but ``lanes`` may be left out.

    Attributes:
      lanes: as in ``Log``.
      has_topology: True if the lanes' predecessors and successors are recorded, False if geometry must give them.
      signal_lane_ids: id of the lane that each signal controls.
      signal_states: ``Signal``.
      signal_positions: stop points [m], NaN where not known.
      agent_ids: an id for each agent.
      agent_types: ``AgentType``.
      agents: columns of ``Scene.agents`` in the frame of the map; NaN where z, speed or a size is not known.
      tiles, seams, routes: empty for a map that was not put together of tiles, or on which nobody has planned.
      metadata: where the map comes from.
    """

    lanes: tuple[MapLane, ...]
    has_topology: bool = True
    signal_lane_ids: tuple[str, ...] = ()
    signal_states: Int[np.ndarray, " S"] = dataclasses.field(default_factory=_NO_WORDS)
    signal_positions: Float64[np.ndarray, "S 3"] = dataclasses.field(default_factory=_NO_POINTS)
    agent_ids: tuple[str, ...] = ()
    agent_types: Int[np.ndarray, " N"] = dataclasses.field(default_factory=_NO_WORDS)
    agents: Float64[np.ndarray, "N 9"] = dataclasses.field(default_factory=_NO_STATES)
    tiles: tuple[MapTile, ...] = ()
    seams: tuple[MapSeam, ...] = ()
    routes: tuple[MapRoute, ...] = ()
    metadata: LogMetadata = dataclasses.field(default_factory=LogMetadata)

    @property
    def num_lanes(self) -> int:
        """L, the number of lanes of every type."""
        return len(self.lanes)

    @property
    def num_agents(self) -> int:
        """N, the number of agents."""
        return len(self.agent_ids)

    @property
    def lane_by_id(self) -> Mapping[str, MapLane]:
        """Every lane by its id; a new table at each call."""
        return {lane.id: lane for lane in self.lanes}

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """x_min, x_max, y_min, y_max of lanes, agents and tiles [m]; zeros for an empty map."""
        points = [lane.points[:, :2] for lane in self.lanes] + [tile.corners for tile in self.tiles]
        stacked = np.concatenate([self.agents[:, :2], *points])
        if not len(stacked):
            return 0.0, 0.0, 0.0, 0.0
        (x_min, y_min), (x_max, y_max) = stacked.min(0), stacked.max(0)
        return float(x_min), float(x_max), float(y_min), float(y_max)


def validate_map(map: Map) -> Map:
    """``map`` itself, if every invariant of the type holds.

    Raises:
      ValueError: naming the first field at fault, what is wrong and how to mend it.
    """
    check_lanes(map.lanes)
    _check_signals(map)
    _check_agents(map)
    lanes = map.lane_by_id
    _check_tiles(map, lanes)
    _check_seams(map, lanes)
    _check_routes(map, lanes)
    return map


def _check_signals(map: Map) -> None:
    count = len(map.signal_lane_ids)
    if map.signal_states.shape != (count,) or map.signal_positions.shape != (count, 3):
        raise ValueError(
            f"signal_states {map.signal_states.shape} and signal_positions {map.signal_positions.shape} do not fit "
            f"{count} signal_lane_ids: give one row each"
        )
    check_unique("signal_lane_ids", map.signal_lane_ids)
    check_range("signal_states", map.signal_states, 0, len(Signal) - 1)
    check_known("signal_positions", map.signal_positions)


def _check_agents(map: Map) -> None:
    count = map.num_agents
    if map.agents.shape != (count, len(STATE_COLUMNS)) or map.agent_types.shape != (count,):
        raise ValueError(
            f"agents {map.agents.shape} and agent_types {map.agent_types.shape} do not fit {count} agent_ids: give one "
            f"row of {len(STATE_COLUMNS)} values and one type each"
        )
    check_unique("agent_ids", map.agent_ids)
    check_range("agent_types", map.agent_types, 0, len(AgentType) - 1)
    if not (np.abs(map.agents[:, :2]) < MAX_COORDINATE).all():
        raise ValueError("agents have NaN or absurd coordinates: leave those agents out")
    check_known("agents", map.agents)
    if not (np.abs(np.hypot(map.agents[:, 4], map.agents[:, 5]) - 1) < 1e-2).all():
        raise ValueError("cos and sin of a heading (agent columns 4 and 5) are not a unit vector: normalize them")


def _check_tiles(map: Map, lanes: Mapping[str, MapLane]) -> None:
    agents = set(map.agent_ids)
    for number, tile in enumerate(map.tiles):
        pose = np.array([tile.x, tile.y, tile.z, tile.yaw])
        if not (np.abs(pose) < MAX_COORDINATE).all():
            raise ValueError(f"tiles: the pose of tile {number} is {pose.tolist()}: give finite meters and radians")
        if tile.attempts < 0:
            raise ValueError(f"tiles: tile {number} has {tile.attempts} attempts: count from 0")
        for name, ids, known in (("lane", tile.lane_ids, lanes), ("agent", tile.agent_ids, agents)):
            if absent := next((item for item in ids if item not in known), None):
                raise ValueError(f"tiles: tile {number} names the {name} {absent!r}, which is not there: leave it out")
    check_unique("tiles: the lanes of all tiles", [item for tile in map.tiles for item in tile.lane_ids])
    check_unique("tiles: the agents of all tiles", [item for tile in map.tiles for item in tile.agent_ids])


def _check_seams(map: Map, lanes: Mapping[str, MapLane]) -> None:
    for number, seam in enumerate(map.seams):
        first, second = seam.tiles
        if first == second or not all(0 <= index < len(map.tiles) for index in seam.tiles):
            raise ValueError(f"seams: seam {number} names the tiles {seam.tiles} of {len(map.tiles)}: name two of them")
        if not (np.abs([seam.start, seam.end]) < MAX_COORDINATE).all():
            raise ValueError(f"seams: the line of seam {number} is not finite: give x, y of both ends")
        members = {item: index for index in seam.tiles for item in map.tiles[index].lane_ids}
        for before, after in seam.connections:
            if {members.get(before), members.get(after)} != {first, second}:
                raise ValueError(
                    f"seams: {before!r} and {after!r} of seam {number} do not lie on both sides of it: name lanes of "
                    f"tile {first} and of tile {second}"
                )
            if after not in lanes[before].successors and before not in lanes[after].predecessors:
                raise ValueError(f"seams: {after!r} does not follow {before!r} in the lanes: list it there too")


def _check_routes(map: Map, lanes: Mapping[str, MapLane]) -> None:
    for number, route in enumerate(map.routes):
        if not route.lane_ids:
            raise ValueError(f"routes: route {number} has no lanes: leave it out")
        if absent := next((item for item in route.lane_ids if item not in lanes), None):
            raise ValueError(f"routes: route {number} names the lane {absent!r}, which is not there: plan it again")
        if map.has_topology:
            for before, after in zip(route.lane_ids[:-1], route.lane_ids[1:], strict=True):
                if after not in following_ids(lanes[before]) and before not in lanes[after].predecessors:
                    raise ValueError(
                        f"routes: {after!r} of route {number} neither follows {before!r} nor lies beside it"
                    )
        if not 0 <= route.start < MAX_COORDINATE or not (route.end is None or 0 <= route.end < MAX_COORDINATE):
            raise ValueError(f"routes: route {number} starts at {route.start} and ends at {route.end} m: give lengths")


def following_ids(lane: MapLane) -> tuple[str, ...]:
    """Ids of the lanes that a car can be on after ``lane``: its successors, and the lanes beside it."""
    return (*lane.successors, *(entry.lane_id for entry in (*lane.left_neighbors, *lane.right_neighbors)))
