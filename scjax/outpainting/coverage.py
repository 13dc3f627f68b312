"""Which ground a map covers, and which of its lanes end at the border of that ground."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from scjax.scene import TILE_SIZE, Map, TileStatus
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.scene.polyline import spread_points

AHEAD = 2.0
"""m beyond a lane's end, where uncovered ground makes it an open end."""

_HALF = TILE_SIZE / 2
_BESIDE_LANES = 1.5  # m around lanes of no tile that count as covered


class OpenEnd(NamedTuple):
    """An end of a lane to which nothing is connected.

    Attributes:
      lane_id: whose end it is.
      is_start: whether it is the lane's start.
      place: x, y, z [m].
      outward: direction out of the lane [rad].
      at_border: whether the ground beyond it is not covered.
    """

    lane_id: str
    is_start: bool
    place: Float64[np.ndarray, " 3"]
    outward: float
    at_border: bool


class Coverage:
    """The ground of a map's tiles, and a narrow strip along lanes that belong to no tile.

    Generated tiles cover their front half alone: what was behind them was there before.

    Args:
      opened: center and direction of a window whose front half counts as uncovered, since it is generated anew.
    """

    def __init__(self, map: Map, opened: tuple[float, float, float] | None = None):
        tiles = [tile for tile in map.tiles if tile.status != TileStatus.MISSING]
        self._poses = np.array([(tile.x, tile.y, tile.yaw) for tile in tiles]).reshape(-1, 3)
        self._rear = np.array([-_HALF if tile.status == TileStatus.KNOWN else 0.0 for tile in tiles])
        self._opened = None if opened is None else np.array([opened])
        of_tiles = {item for tile in map.tiles for item in tile.lane_ids}
        free = [spread_points(lane.points[:, :2]) for lane in map.lanes if lane.id not in of_tiles]
        from scipy.spatial import KDTree

        self._lanes = KDTree(np.concatenate(free)) if free else None

    def contains(self, points: Float64[np.ndarray, "n 2"], margin: float = 0.0) -> Bool[np.ndarray, " n"]:
        """Whether points lie on covered ground, at least ``margin`` [m] inside a tile."""
        covered = np.any(_in_windows(points, self._poses, self._rear, margin), axis=-1, keepdims=True)[:, 0]
        if self._lanes is not None and len(points):
            covered |= np.asarray(self._lanes.query(points)[0]) < _BESIDE_LANES
        if self._opened is not None:
            covered &= ~_in_windows(points, self._opened, np.zeros(1), 0.0)[:, 0]
        return covered

    def share_ahead(self, x: float, y: float, yaw: float) -> float:
        """Share of the front half of a window that is covered."""
        across, ahead = np.meshgrid(np.linspace(-28.0, 28.0, 8), np.linspace(4.0, 28.0, 4))
        cos, sin = np.cos(yaw), np.sin(yaw)
        points = np.stack([x + cos * ahead - sin * across, y + sin * ahead + cos * across], -1)
        return float(self.contains(points.reshape(-1, 2)).mean())

    def open_ends(self, map: Map) -> list[OpenEnd]:
        """All ends of lanes for cars to which nothing is connected."""
        starts, ends_met = connected_ends(map)
        ends: list[tuple[str, bool, np.ndarray, float]] = []
        for lane in map.lanes:
            if lane.lane_type in NO_CAR_LANE_TYPES:
                continue
            for is_start, is_connected in ((True, lane.id in starts), (False, lane.id in ends_met)):
                heading = outward_heading(lane.points, is_start)
                if not is_connected and heading is not None:
                    ends.append((lane.id, is_start, lane.points[0 if is_start else -1], heading))
        if not ends:
            return []
        places = np.array([place[:2] for _, _, place, _ in ends])
        headings = np.array([heading for *_, heading in ends])
        beyond = places + AHEAD * np.stack([np.cos(headings), np.sin(headings)], -1)
        at_border = ~self.contains(beyond)
        return [
            OpenEnd(lane_id, is_start, place, outward, bool(border))
            for (lane_id, is_start, place, outward), border in zip(ends, at_border, strict=True)
        ]


def connected_ends(map: Map) -> tuple[set[str], set[str]]:
    """Ids of the lanes whose start, and of those whose end, is connected to another lane."""
    starts = {lane.id for lane in map.lanes if lane.predecessors}
    ends = {lane.id for lane in map.lanes if lane.successors}
    starts |= {item for lane in map.lanes for item in lane.successors}
    return starts, ends | {item for lane in map.lanes for item in lane.predecessors}


def outward_heading(points: Float64[np.ndarray, "points 3"], is_start: bool) -> float | None:
    """Direction out of a lane at its start or end [rad]; None for a lane of no length."""
    steps = np.diff(points[:, :2], axis=0)
    steps = steps[np.hypot(*steps.T) > 1e-6]
    if not len(steps):
        return None
    x, y = -steps[0] if is_start else steps[-1]
    return float(np.arctan2(y, x))


def _in_windows(
    points: Float64[np.ndarray, "n 2"], poses: Float64[np.ndarray, "windows 3"], rear: np.ndarray, margin: float
) -> Bool[np.ndarray, "n windows"]:
    offsets = points[:, None] - poses[None, :, :2]
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = cos * offsets[..., 0] + sin * offsets[..., 1]
    y = cos * offsets[..., 1] - sin * offsets[..., 0]
    return (x > rear + margin) & (x < _HALF - margin) & (np.abs(y) < _HALF - margin)
