"""A map without some of its lanes and agents."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

import numpy as np

from scjax.scene.map import Map, MapSeam, MapTile
from scjax.scene.map_lane import MapLane


def remove_from_map(map: Map, lane_ids: Collection[str] = (), agent_ids: Collection[str] = ()) -> Map:
    """``map`` without these lanes, their signals and these agents; nothing names them any longer.

    Raises:
      ValueError: there is no such lane or agent, or a route uses the lane.
    """
    lanes, agents = set(lane_ids), set(agent_ids)
    for name, given, there in (("lane", lanes, {lane.id for lane in map.lanes}), ("agent", agents, set(map.agent_ids))):
        if given - there:
            raise ValueError(f"the map has no {name} {min(given - there)!r}: name one that it has")
    for route in map.routes:
        if lanes & set(route.lane_ids):
            item = min(lanes & set(route.lane_ids))
            raise ValueError(f"lane {item!r} is part of route {route.name!r}: remove the route first")
    signals = np.array([row for row, item in enumerate(map.signal_lane_ids) if item not in lanes], int)
    rows = np.array([row for row, item in enumerate(map.agent_ids) if item not in agents], int)
    return dataclasses.replace(
        map,
        lanes=tuple(_lane_without(lane, lanes) for lane in map.lanes if lane.id not in lanes),
        signal_lane_ids=tuple(map.signal_lane_ids[row] for row in signals),
        signal_states=map.signal_states[signals],
        signal_positions=map.signal_positions[signals],
        agent_ids=tuple(map.agent_ids[row] for row in rows),
        agent_types=map.agent_types[rows],
        agents=map.agents[rows],
        tiles=tuple(_tile_without(tile, lanes, agents) for tile in map.tiles),
        seams=tuple(_seam_without(seam, lanes) for seam in map.seams),
    )


def _lane_without(lane: MapLane, lanes: set[str]) -> MapLane:
    return dataclasses.replace(
        lane,
        predecessors=tuple(item for item in lane.predecessors if item not in lanes),
        successors=tuple(item for item in lane.successors if item not in lanes),
        left_neighbors=tuple(one for one in lane.left_neighbors if one.lane_id not in lanes),
        right_neighbors=tuple(one for one in lane.right_neighbors if one.lane_id not in lanes),
    )


def _tile_without(tile: MapTile, lanes: set[str], agents: set[str]) -> MapTile:
    return dataclasses.replace(
        tile,
        lane_ids=tuple(item for item in tile.lane_ids if item not in lanes),
        agent_ids=tuple(item for item in tile.agent_ids if item not in agents),
    )


def _seam_without(seam: MapSeam, lanes: set[str]) -> MapSeam:
    pairs = tuple(pair for pair in seam.connections if not lanes.intersection(pair))
    return dataclasses.replace(seam, connections=pairs)
