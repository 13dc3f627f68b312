"""The way of a route through a map that grows: which exit is next, and where to go back to if none leads on."""

from __future__ import annotations

import collections
import dataclasses

import numpy as np
from jaxtyping import Float64

from scjax.outpainting.exits import RoadExit, choose_exit, find_exits, pose_beyond
from scjax.scene import Map, MapRoute, TileStatus, route_line
from scjax.scene.polyline import cumulative_length

MAX_TRIES = 2
"""Tiles at one exit, at most."""

_PROGRESS = 16.0  # m by which a route must become longer than ever before, so that it may go back as often again
_EACH = 3  # times of going back, after which it goes back by one tile more at a time
_TAKEN_BACK = "taken back: the road does not go on from here"


@dataclasses.dataclass
class _Fork:
    """A map, the lanes of the route so far, its direction there [rad], and how often each exit was tried."""

    map: Map
    lane_ids: tuple[str, ...]
    yaw: float
    tries: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    exits: list[RoadExit] | None = None


class RouteSearch:
    """A route that grows tile by tile, in depth first.

    Where no exit leads on, its last tile is taken back, and another exit of the tile before is tried, or the same one
    once more. Where that fails again and again, more tiles are taken back at a time.

    Args:
      first: lane with which the route begins.
      way, rng: as for ``choose_exit``.
      returns: how often the route may go back without becoming longer than before.

    Attributes:
      map: the present one.
      best: the one with the longest route so far.
      length: of the route to the exit chosen last [m].
    """

    def __init__(
        self,
        map: Map,
        first: str,
        way: str | Float64[np.ndarray, "points 2"],
        rng: np.random.Generator,
        *,
        returns: int,
    ):
        self._forks = [_Fork(map, (first,), pose_beyond(map.lane_by_id[first].points).yaw)]
        self._way, self._rng, self._max_returns = way, rng, returns
        self._returns, self._longest, self._chosen = 0, 0.0, None
        self.best, self.length = map, 0.0

    @property
    def map(self) -> Map:
        return self._forks[-1].map

    @property
    def depth(self) -> int:
        """Number of tiles that the route goes through, without those of the start."""
        return len(self._forks) - 1

    def next_exit(self) -> RoadExit | None:
        """The exit at which the next tile is to be made; tiles that lead nowhere are taken back before."""
        while True:
            fork = self._forks[-1]
            if fork.exits is None:
                fork.exits = find_exits(fork.map, fork.lane_ids[-1])
            open_exits = [one for one in fork.exits if fork.tries[one.lane_ids[-1]] < MAX_TRIES]
            fewest = min((fork.tries[one.lane_ids[-1]] for one in open_exits), default=0)
            for tries in range(fewest, MAX_TRIES):
                fresh = [one for one in open_exits if fork.tries[one.lane_ids[-1]] == tries]
                chosen = choose_exit(fresh, self._rng, yaw=fork.yaw, way=self._way)
                if chosen is not None:
                    return chosen
            if self.depth == 0 or self._returns >= self._max_returns:
                return None
            self._go_back(1 + self._returns // _EACH)
            self._returns += 1

    def tries(self, chosen: RoadExit) -> int:
        """How often a tile at this exit has failed."""
        return self._forks[-1].tries[chosen.lane_ids[-1]]

    def routed(self, chosen: RoadExit) -> Map:
        """The map whose first route leads to this exit."""
        fork = self._forks[-1]
        routed = _with_route(fork.map, (*fork.lane_ids, *chosen.lane_ids[1:]))
        self._chosen, self.length = chosen, float(cumulative_length(route_line(routed, routed.routes[0]))[-1])
        if self.length > self._longest + _PROGRESS:
            self._returns = 0
        if self.length > self._longest:
            self.best, self._longest = routed, self.length
        return routed

    def add(self, grown: Map) -> Map:
        """Takes the map with one tile more at the exit of ``routed``, and returns it."""
        fork, chosen = self._forks[-1], self._chosen
        assert chosen is not None
        fork.tries[chosen.lane_ids[-1]] += 1
        lane_ids = (*fork.lane_ids, *chosen.lane_ids[1:])
        if grown.lane_by_id[lane_ids[-1]].successors:
            self._forks.append(_Fork(grown, lane_ids, chosen.pose.yaw))
        else:
            fork.map, fork.exits = grown, None
        if self.length >= self._longest:
            self.best = grown
        return grown

    def _go_back(self, tiles: int) -> None:
        """Takes the last tiles back; the map still says that they were tried."""
        last = self._forks[-1].map
        del self._forks[max(len(self._forks) - tiles, 1) :]
        fork = self._forks[-1]
        gone = [
            tile
            if tile.status == TileStatus.MISSING
            else dataclasses.replace(tile, status=TileStatus.MISSING, fault=_TAKEN_BACK, lane_ids=(), agent_ids=())
            for tile in last.tiles[len(fork.map.tiles) :]
        ]
        fork.map = dataclasses.replace(fork.map, tiles=(*fork.map.tiles, *gone))


def _with_route(map: Map, lane_ids: tuple[str, ...]) -> Map:
    start = map.routes[0].start if map.routes and map.routes[0].lane_ids[0] == lane_ids[0] else 0.0
    route = MapRoute(lane_ids=lane_ids, start=start, name="outpainted")
    return dataclasses.replace(map, routes=(route, *map.routes[1:]))
