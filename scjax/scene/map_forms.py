"""Maps from scenes and logs, and back: one frame for all."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from scjax.scene.log import NO_EGO, OTHER_OBJECT, Log
from scjax.scene.map import Map, MapSeam, MapTile, TileStatus
from scjax.scene.map_lane import LaneNeighbor, MapLane
from scjax.scene.scene import TILE_SIZE, Crop, Link, Scene, Signal, unpadded


def log_to_map(log: Log, step: int = 0) -> Map:
    """The map of a log with signals and agents as they are at ``step``. Objects of no ``AgentType`` are left out.

    Raises:
      ValueError: there is no such step.
    """
    if not 0 <= step < log.num_steps:
        raise ValueError(f"step is {step}: give one of the {log.num_steps} steps of the log, counted from 0")
    rows = np.flatnonzero(log.valid[:, step] & (log.object_types != OTHER_OBJECT))
    headings = log.headings[rows, step]
    columns = [
        log.positions[rows, step],
        np.hypot(*log.velocities[rows, step].T)[:, None],
        np.stack([np.cos(headings), np.sin(headings)], -1),
        log.sizes[rows],
    ]
    return Map(
        lanes=log.lanes,
        has_topology=log.has_topology,
        signal_lane_ids=log.signal_lane_ids,
        signal_states=log.signal_states[:, step],
        signal_positions=log.signal_positions,
        agent_ids=tuple(log.object_ids[row] for row in rows),
        agent_types=log.object_types[rows],
        agents=np.concatenate(columns, axis=1),
        metadata=log.metadata,
    )


def map_to_log(map: Map) -> Log:
    """A log of one step at time 0 with the agents as objects; it has no ego."""
    heading = np.arctan2(map.agents[:, 5], map.agents[:, 4])
    direction = np.stack([np.cos(heading), np.sin(heading)], -1)
    return Log(
        timestamps=np.zeros(1),
        object_ids=map.agent_ids,
        object_types=map.agent_types,
        valid=np.ones((map.num_agents, 1), bool),
        positions=map.agents[:, None, :3],
        headings=heading[:, None],
        velocities=(map.agents[:, 3:4] * direction)[:, None],
        sizes=map.agents[:, 6:],
        ego_index=NO_EGO,
        signal_lane_ids=map.signal_lane_ids,
        signal_states=map.signal_states[:, None],
        signal_positions=map.signal_positions,
        lanes=map.lanes,
        has_topology=map.has_topology,
        metadata=map.metadata,
    )


def scene_to_map(
    scene: Scene,
    *,
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
    yaw: float = 0.0,
    name: str = "0",
    status: TileStatus = TileStatus.KNOWN,
    prompt: str = "",
    attempts: int = 0,
) -> Map:
    """A map of one tile that shows ``scene``.

    Args:
      scene: a single scene.
      x, y, z, yaw: where the scene's origin, its ego, lies in the map, and the direction of its x axis [m, rad].
      name: begins the ids of lanes and agents, as in "0.lane-3"; tiles of one map need different ones.
      status, prompt, attempts: of the tile.

    Raises:
      ValueError: on a batch of scenes.
    """
    if scene.batch_shape:
        raise ValueError(f"scene_to_map takes one scene, this is a batch {scene.batch_shape}: index it")
    scene = unpadded(scene.to_numpy())
    origin, cos, sin = np.array([x, y, z]), float(np.cos(yaw)), float(np.sin(yaw))
    rotation = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    lanes = np.asarray(scene.lanes, np.float64) @ rotation + origin
    lanes[~np.asarray(scene.lane_known)[:, 2], :, 2] = np.nan
    agents = np.array(scene.agents, np.float64)
    agents[:, :3] = agents[:, :3] @ rotation + origin
    agents[:, 4:6] = agents[:, 4:6] @ rotation[:2, :2]
    known = np.array(scene.agent_known)
    known[:, [0, 1, 4, 5]] = True
    agents[~known] = np.nan
    ids = [f"{name}.lane-{row}" for row in range(len(lanes))]
    signals = np.asarray(scene.signals, np.int32)
    lit = np.flatnonzero(signals != Signal.UNKNOWN)
    agent_ids = tuple(f"{name}.agent-{row}" for row in range(len(agents)))
    shift = TILE_SIZE / 2 if scene.crop == Crop.FORWARD else 0.0
    tile = MapTile(
        x=x + shift * cos,
        y=y + shift * sin,
        z=z,
        yaw=yaw,
        status=status,
        attempts=attempts,
        prompt=prompt,
        lane_ids=tuple(ids),
        agent_ids=agent_ids,
    )
    return Map(
        lanes=_lanes_of(scene, lanes, ids),
        signal_lane_ids=tuple(ids[row] for row in lit),
        signal_states=signals[lit],
        signal_positions=lanes[lit, 0],
        agent_ids=agent_ids,
        agent_types=np.asarray(scene.agent_types, np.int32),
        agents=agents,
        tiles=(tile,),
    )


def _lanes_of(scene: Scene, points: np.ndarray, ids: list[str]) -> tuple[MapLane, ...]:
    """Lanes with these points and ids, and the relations of ``scene``."""
    links = np.asarray(scene.links)

    def named(relations: np.ndarray, link: Link) -> list[tuple[str, ...]]:
        return [tuple(ids[j] for j in np.flatnonzero(row == link)) for row in relations]

    predecessors, successors = named(links.T, Link.PREDECESSOR), named(links, Link.PREDECESSOR)
    left, right = named(links.T, Link.LEFT), named(links.T, Link.RIGHT)
    return tuple(
        MapLane(
            id=ids[row],
            lane_type=None,
            points=points[row],
            predecessors=predecessors[row],
            successors=successors[row],
            left_neighbors=tuple(map(LaneNeighbor, left[row])),
            right_neighbors=tuple(map(LaneNeighbor, right[row])),
        )
        for row in range(len(ids))
    )


def add_agents(
    map: Map, scene: Scene, rows: Iterable[int], *, x: float, y: float, z: float = 0.0, yaw: float = 0.0, name: str
) -> Map:
    """``map`` with some agents of a scene; lanes, signals and the agents that it has stay as they are.

    Args:
      scene: a single scene without padding.
      rows: indices of its agents.
      x, y, z, yaw: where the scene's origin lies in the map, and the direction of its x axis [m, rad].
      name: begins the ids, as in "name.agent-3"; a number is added to it where the map has such ids.
    """
    names = (name, *(f"{name}-{number}" for number in range(2, map.num_agents + 3)))
    name = next(one for one in names if not any(item.startswith(f"{one}.agent-") for item in map.agent_ids))
    other, chosen = scene_to_map(scene, x=x, y=y, z=z, yaw=yaw, name=name), list(rows)
    return dataclasses.replace(
        map,
        agent_ids=(*map.agent_ids, *(other.agent_ids[row] for row in chosen)),
        agent_types=np.concatenate([map.agent_types, other.agent_types[chosen]]),
        agents=np.concatenate([map.agents, other.agents[chosen]]),
    )


def join_maps(
    first: Map, second: Map, connections: Iterable[tuple[str, str]] = (), seams: Iterable[MapSeam] = ()
) -> Map:
    """Both maps in one, in the same frame; ids must differ.

    Args:
      connections: pairs of lane ids, the second follows the first; they are listed in the lanes.
      seams: to add; their tiles count through those of ``first`` and then of ``second``. Their connections are listed
        in the lanes too.

    Raises:
      ValueError: a connection names a lane that neither map has.
    """
    seams = tuple(seams)
    count = len(first.tiles)
    moved = tuple(
        dataclasses.replace(seam, tiles=(seam.tiles[0] + count, seam.tiles[1] + count)) for seam in second.seams
    )
    lanes = {lane.id: lane for lane in (*first.lanes, *second.lanes)}
    for before, after in (*connections, *(pair for seam in seams for pair in seam.connections)):
        if before not in lanes or after not in lanes:
            raise ValueError(
                f"connections: {before!r} or {after!r} is no lane of the two maps: name lanes by their ids"
            )
        one = lanes[before]
        if after not in one.successors:
            lanes[before] = dataclasses.replace(one, successors=(*one.successors, after))
        other = lanes[after]
        if before not in other.predecessors:
            lanes[after] = dataclasses.replace(other, predecessors=(*other.predecessors, before))
    if len(lanes) < first.num_lanes + second.num_lanes:
        raise ValueError("the two maps share ids of lanes: give their scenes different names")
    return Map(
        lanes=tuple(lanes.values()),
        has_topology=first.has_topology and second.has_topology,
        signal_lane_ids=first.signal_lane_ids + second.signal_lane_ids,
        signal_states=np.concatenate([first.signal_states, second.signal_states]),
        signal_positions=np.concatenate([first.signal_positions, second.signal_positions]),
        agent_ids=first.agent_ids + second.agent_ids,
        agent_types=np.concatenate([first.agent_types, second.agent_types]),
        agents=np.concatenate([first.agents, second.agents]),
        tiles=first.tiles + second.tiles,
        seams=first.seams + moved + seams,
        routes=first.routes + second.routes,
        metadata=first.metadata,
    )
