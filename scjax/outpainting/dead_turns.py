"""Turns that lead nowhere: generated lanes beside others that go on, which no later tile continues."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.outpainting.coverage import OpenEnd
from scjax.scene import AgentType, Map, TileStatus
from scjax.scene.dead_turns import dead_turn
from scjax.scene.map_removal import remove_from_map
from scjax.scene.polyline import cumulative_length, spread_points

_OWN_PLACE = 2.0  # m from the center of a window, where the lane that it continues ends
_ON_LANE = 2.0  # m from the middle of a lane


class DeadTurns:
    """Which lanes of a map can be left out where nothing continues them.

    Those are lanes of generated tiles that no route uses, up to the place where the road has another way.

    Args:
      map: its lanes list each connection on both sides (``connect_lanes``).
      x, y: center of a window; the lane that ends there stays.
    """

    def __init__(self, map: Map, open_ends: Sequence[OpenEnd], x: float, y: float):
        lengths = {lane.id: float(cumulative_length(lane.points)[-1]) for lane in map.lanes}
        self._lengths = lengths
        self._after = {lane.id: set(lane.successors) for lane in map.lanes}
        self._before = {lane.id: set(lane.predecessors) for lane in map.lanes}
        generated = {item for tile in map.tiles if tile.status != TileStatus.KNOWN for item in tile.lane_ids}
        self._kept = set(lengths) - generated
        self._kept.update(item for route in map.routes for item in route.lane_ids)
        near = [end for end in open_ends if np.hypot(end.place[0] - x, end.place[1] - y) < _OWN_PLACE]
        self._kept.update(end.lane_id for end in near)

    def of(self, ends: Sequence[OpenEnd]) -> tuple[set[str], list[OpenEnd]]:
        """Lanes that can be left out if nothing continues these ends, and the ends that stay."""
        removed: set[str] = set()
        staying = []
        for end in ends:
            ways = (self._after, self._before) if end.is_start else (self._before, self._after)
            lanes = dead_turn(end.lane_id, *ways, self._lengths, kept=self._kept, removed=removed)
            removed |= lanes
            if not lanes:
                staying.append(end)
        return removed, staying


def without_turns(map: Map, lane_ids: set[str]) -> Map:
    """``map`` without these lanes and the generated vehicles on them that are on no other lane."""
    if not lane_ids:
        return map
    from scipy.spatial import KDTree

    trees = []
    for is_removed in (True, False):
        lines = [spread_points(lane.points[:, :2]) for lane in map.lanes if (lane.id in lane_ids) == is_removed]
        trees.append(KDTree(np.concatenate(lines)))
    on_removed, on_others = (np.asarray(tree.query(map.agents[:, :2])[0]) < _ON_LANE for tree in trees)
    generated = {item for tile in map.tiles if tile.status != TileStatus.KNOWN for item in tile.agent_ids}
    rows = np.flatnonzero(on_removed & ~on_others & (map.agent_types == AgentType.VEHICLE))
    return remove_from_map(map, lane_ids, {map.agent_ids[row] for row in rows} & generated)
