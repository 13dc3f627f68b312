"""A map that grows ahead of a driven agent: which exit is next, and tiles that are thrown away again."""

from __future__ import annotations

import collections
import dataclasses
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float64

from scjax.generate.conditions import Condition
from scjax.outpainting.exits import RoadExit, choose_exit, find_exits
from scjax.outpainting.extend import extend_map
from scjax.outpainting.route_search import MAX_TRIES
from scjax.outpainting.window import HALF
from scjax.scene import Map, MapTile, TileStatus
from scjax.scene.angles import wrap_to_pi

SIGHT = 60.0
"""m around the driven agent, within which no tile is thrown away."""

_MAX_RETURNS = 8  # tiles that are taken back in a row
_NO_WAY, _TAKEN_BACK = "the road does not go on beyond it", "taken back: the road does not go on from here"


@dataclasses.dataclass(frozen=True)
class _Stage:
    """What was there before a tile: the map, the direction of the way [rad] and the lanes of it."""

    map: Map
    yaw: float
    path: tuple[str, ...]


class MapGrowth:
    """Adds tiles at the end of a way.

    A tile beyond which no road goes on is thrown away and drawn again, or another exit is next. Where no exit is left,
    the last tiles are taken back, as long as they are out of sight of the agent that drives toward them.

    Args:
      key: typed key of the tiles.
      map: the first one.
      condition: what tiles show.
      way, rng, yaw: as for ``choose_exit``.
      outpainting: options of ``scjax.extend_map``.

    Attributes:
      map: the present one.
      path: lanes from the driven agent to the one at which the last tile was added; empty before.
      gone: tiles that were taken back by the last ``extend``.
    """

    def __init__(
        self,
        key: Array,
        map: Map,
        condition: Condition | str | None,
        *,
        way: Any,
        yaw: float,
        rng: np.random.Generator,
        **outpainting: Any,
    ):
        self.map, self.path = map, ()
        self.gone: list[MapTile] = []
        self._key, self._condition, self._outpainting = key, condition, outpainting
        self._way, self._yaw, self._first_yaw, self._rng = way, yaw, yaw, rng
        self._tries, self._stages, self._returns = collections.Counter[str](), list[_Stage](), 0

    def extend(self, first: str, place: Float64[np.ndarray, " 2"]) -> bool:
        """Adds one tile at an exit that can be reached from lane ``first``.

        Args:
          place: of the driven agent [m].

        Returns:
          False: no road goes on from there, and the map is what it was.
        """
        self.gone, unchanged = [], (self.map, self._yaw, self.path)
        while True:
            chosen = self._next_exit(self.map, first, self._yaw, self.path)
            if chosen is None and self._take_back(place):
                continue
            if chosen is None:
                self.gone, (self.map, self._yaw, self.path) = [], unchanged
                return False
            before, exit_id, pose = self.map, chosen.lane_ids[-1], chosen.pose
            self._tries[exit_id] += 1
            key = jax.random.fold_in(self._key, len(before.tiles))
            grown = extend_map(key, before, self._condition, x=pose.x, y=pose.y, yaw=pose.yaw, **self._outpainting)
            continues = grown.num_lanes > before.num_lanes and grown.lane_by_id[exit_id].successors
            if continues and self._next_exit(grown, exit_id, pose.yaw) is not None:
                self._stages.append(_Stage(before, self._yaw, self.path))
                self.map, self._yaw, self.path = grown, self._onward(pose.yaw), tuple(chosen.lane_ids)
                self._returns = max(self._returns - 1, 0)
                return True
            self.map = _with_missing(before, grown.tiles[len(before.tiles) :], _NO_WAY)

    def _next_exit(self, map: Map, first: str, yaw: float, path: tuple[str, ...] = ()) -> RoadExit | None:
        """Of the exits that were tried least often the one nearest to the way; first those at which ``path`` goes on.

        Without that, tiles would be added here and there, and none of the ways would become long.
        """
        exits = [one for one in find_exits(map, first) if self._tries[one.lane_ids[-1]] < MAX_TRIES]
        onward = [one for one in exits if path and path[-1] in one.lane_ids]
        for some in (onward, exits):
            for tries in range(MAX_TRIES):
                fresh = [one for one in some if self._tries[one.lane_ids[-1]] == tries]
                chosen = choose_exit(fresh, self._rng, yaw=yaw, way=self._way)
                if chosen is not None:
                    return chosen
        return None

    def _onward(self, yaw: float) -> float:
        """The direction nearest to ``yaw`` that does not lead back [rad]: the map is in the way there."""
        return self._first_yaw + float(np.clip(wrap_to_pi(yaw - self._first_yaw), -np.pi / 2, np.pi / 2))

    def _take_back(self, place: Float64[np.ndarray, " 2"]) -> bool:
        """Takes the last tile back; False: there is none, or it is in sight."""
        if not self._stages or self._returns >= _MAX_RETURNS:
            return False
        stage = self._stages[-1]
        tiles = self.map.tiles[len(stage.map.tiles) :]
        laid = [tile for tile in tiles if tile.status != TileStatus.MISSING]
        if any(in_front_half(place[None], tile, SIGHT).any() for tile in laid):
            return False
        self._stages.pop()
        self._returns += 1
        self.gone += laid
        self.map = _with_missing(stage.map, tiles, _TAKEN_BACK)
        self._yaw, self.path = stage.yaw, stage.path
        return True


def in_front_half(places: Float64[np.ndarray, "n 2"], tile: MapTile, margin: float = 0.0) -> Bool[np.ndarray, " n"]:
    """Whether places lie in the half of a generated tile that is its own, or less than ``margin`` [m] from it."""
    cos, sin = np.cos(tile.yaw), np.sin(tile.yaw)
    x, y = ((places - [tile.x, tile.y]) @ np.array([[cos, -sin], [sin, cos]])).T
    return (x > -margin) & (x < HALF + margin) & (np.abs(y) < HALF + margin)


def _with_missing(map: Map, tiles: tuple[MapTile, ...], fault: str) -> Map:
    """``map`` that lists tiles of which nothing is left."""
    gone = [
        tile
        if tile.status == TileStatus.MISSING
        else dataclasses.replace(tile, status=TileStatus.MISSING, fault=fault, lane_ids=(), agent_ids=())
        for tile in tiles
    ]
    return dataclasses.replace(map, tiles=(*map.tiles, *gone))
