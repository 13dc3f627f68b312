"""``scjax.outpaint``: a map along a route or over an area, from one scene."""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float64

from scjax.data.map_joins import connect_lanes
from scjax.generate.arguments import as_model, sampling_key
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.sample import sample_scenes
from scjax.outpainting.coverage import Coverage
from scjax.outpainting.exits import MAX_COVERED, RoadExit, find_exits, pose_beyond, start_lane
from scjax.outpainting.extend import extend_map, open_condition
from scjax.outpainting.route_search import RouteSearch
from scjax.outpainting.window import WindowPose
from scjax.scene import Map, Scene, TileStatus, scene_to_map, validate_map
from scjax.scene.arguments import finite_number, whole_number

LENGTH = 200.0
"""m of a route, where neither length nor area is given."""

MAX_LENGTH, MAX_TILES = 20_000.0, 1000
ROUTES = ("straight", "random")
"""Names of ways to choose a route."""

_STEPS_BACK = ((0.0, 8.0), (4.0, 2.0))  # m by which windows are moved back, at an exit and where that failed
_RETURNS = 4  # how often, for each try of a tile, a route that ends goes back before it gives up
_START_KEY, _STARTS = 0x57, 4  # folded into the key for the first scene; so many are tried


def outpaint(
    key: Array | int,
    start: Scene | Map | None = None,
    condition: Condition | str | Sequence[Condition | str] | None = None,
    **options: Any,
) -> Map:
    """A map that grows from a scene or a map, tile by tile, along a route or over an area.

    Args:
      key: typed key, or the number of one.
      start: a single scene around its ego, or a map; None: a scene that is sampled for the condition, again if its ego
        cannot leave it. Of a map only the connections that a car can drive count and stay (``connect_lanes``).
      condition: what new tiles shall show; a sequence: tile by tile, and the last for all further ones.
      options: those of ``outpaint_steps``.

    Returns:
      A valid map. Its tiles say how each went; its first route is the one along which it grew. The map is shorter than
      requested where the road ends or no candidate continues it.

    Raises:
      ValueError: as ``outpaint_steps``.
    """
    (last,) = collections.deque(outpaint_steps(key, start, condition, **options), maxlen=1)
    return validate_map(last)


def outpaint_steps(
    key: Array | int,
    start: Scene | Map | None = None,
    condition: Condition | str | Sequence[Condition | str] | None = None,
    *,
    length: float | None = None,
    route: str | Sequence[tuple[float, float]] = "straight",
    area: tuple[float, float, float, float] | None = None,
    at: tuple[float, float, float] | None = None,
    max_tiles: int = MAX_TILES,
    candidates: int = 8,
    retries: int = 2,
    model: Model | str | Path | None = None,
    num_steps: int | None = None,
) -> Iterator[Map]:
    """As ``outpaint``, but gives the map after every tile; the first is that of ``start``.

    Args:
      length: of the route, from the ego [m]; 200 if there is no area either. A route that ends too early goes back to
        an earlier exit; the tiles behind it are taken back. After 4 times for each try of a tile (``retries``) in which
        it has not become longer than before, the longest one stays.
      route: "straight", "random", or points x, y that it shall pass [m].
      area: x_min, x_max, y_min, y_max [m]: the map grows at all roads that lead out, until they leave this area.
        Instead of ``length``.
      at: x, y [m] and direction [rad] where the route begins on a map; by default where the map's first route begins,
        else at its first tile's center.
      max_tiles: new tiles at most, those that are taken back included.
      candidates, retries, model, num_steps: as in ``extend_map``.

    Raises:
      ValueError: an option out of range, a start without a road, or a condition that the model cannot meet.
    """
    key, model = sampling_key(key), as_model(model)
    conditions = _conditions(condition)
    max_tiles = whole_number(max_tiles, "max_tiles", 1, MAX_TILES)
    way = _way(route)
    if area is not None and length is not None:
        raise ValueError("length and area are both given: leave one of them out")
    length = finite_number(LENGTH if length is None else length, "length", 1.0, MAX_LENGTH)
    if start is None:
        start = _sampled_start(key, conditions[0], model, num_steps)
    map, first = _start(start, at)
    options = {"candidates": candidates, "retries": retries, "model": model, "num_steps": num_steps}
    yield map
    grower = _Grower(key, conditions, options)
    if area is not None:
        yield from grower.over_area(map, _checked_area(area), max_tiles)
    else:
        yield from grower.along_route(map, first, length, way, max_tiles)


@dataclasses.dataclass
class _Grower:
    """Adds tiles to maps; ``number`` counts them."""

    key: Array
    conditions: Sequence[Condition | str | None]
    options: dict[str, Any]
    number: int = 0

    def along_route(
        self, map: Map, first: str, length: float, way: str | Float64[np.ndarray, "points 2"], max_tiles: int
    ) -> Iterator[Map]:
        """Grows at the end of a route that begins on lane ``first``; where it ends too early, goes back."""
        rng = np.random.default_rng(np.asarray(jax.random.key_data(self.key)).astype(np.uint32))
        search = RouteSearch(map, first, way, rng, returns=_RETURNS * (1 + self.options["retries"]))
        while self.number < max_tiles and (chosen := search.next_exit()):
            routed = search.routed(chosen)
            if search.length >= length:
                yield routed
                return
            yield search.add(self._beyond(routed, chosen, search.depth, search.tries(chosen)))
        if search.best is not search.map:
            yield search.best

    def over_area(self, map: Map, area: tuple[float, float, float, float], max_tiles: int) -> Iterator[Map]:
        """Grows at every open end whose window's center is in the area, the least covered first."""
        blocked: set[str] = set()
        while self.number < max_tiles:
            coverage = Coverage(map)
            lanes, places = map.lane_by_id, []
            for end in coverage.open_ends(map):
                if end.at_border and not end.is_start and end.lane_id not in blocked:
                    pose = pose_beyond(lanes[end.lane_id].points)
                    covered = coverage.share_ahead(pose.x, pose.y, pose.yaw)
                    if _inside(pose, area) and covered <= MAX_COVERED:
                        places.append(RoadExit((end.lane_id,), pose, covered))
            if not places:
                return
            chosen = min(places, key=lambda one: one.covered)
            blocked.add(chosen.lane_ids[-1])
            map = self._beyond(map, chosen, self.number)
            yield map

    def _beyond(self, map: Map, chosen: RoadExit, turn: int, tries: int = 0) -> Map:
        """The map with a tile at an exit; if that tile is not complete, one a little farther back is tried.

        Args:
          turn: number of the condition.
          tries: how often this exit has failed.
        """
        condition = self.conditions[min(turn, len(self.conditions) - 1)]
        points = map.lane_by_id[chosen.lane_ids[-1]].points
        best = None
        for attempt, back in enumerate(_STEPS_BACK[min(tries, len(_STEPS_BACK) - 1)]):
            pose = pose_beyond(points, back)
            key = jax.random.fold_in(jax.random.fold_in(self.key, self.number), attempt)
            grown = extend_map(key, map, condition, x=pose.x, y=pose.y, yaw=pose.yaw, **self.options)
            if best is None or (best.tiles[-1].status, grown.tiles[-1].status) in _BETTER:
                best = grown
            if best.tiles[-1].status == TileStatus.COMPLETE:
                break
        assert best is not None
        self.number += 1
        return best


_BETTER = {
    (TileStatus.MISSING, TileStatus.INCOMPLETE),
    (TileStatus.MISSING, TileStatus.COMPLETE),
    (TileStatus.INCOMPLETE, TileStatus.COMPLETE),
}


def _sampled_start(key: Array, condition: Condition, model: Model, num_steps: int | None) -> Scene:
    """A scene for a condition: the first of a few whose ego can drive on to the border, or the first of all."""
    scenes = []
    for attempt in range(_STARTS):
        drawn = jax.random.fold_in(key, _START_KEY)
        drawn = jax.random.fold_in(drawn, attempt) if attempt else drawn
        scenes.append(sample_scenes(drawn, condition, model=model, num_steps=num_steps, repair=True)[0])
        try:
            map, first = _start(scenes[-1], None)
        except ValueError:
            continue
        if any(one.covered <= MAX_COVERED for one in find_exits(map, first)):
            return scenes[-1]
    return scenes[0]


def _start(start: Scene | Map, at: tuple[float, float, float] | None) -> tuple[Map, str]:
    """The map to begin with, and the first lane of the route."""
    if isinstance(start, Scene):
        if at is not None:
            raise ValueError("at is for maps: the route of a scene begins at its ego")
        map = scene_to_map(start)
        return map, start_lane(map, 0.0, 0.0, 0.0)
    if not isinstance(start, Map):
        raise ValueError(f"start must be a scjax.Scene or a scjax.Map, not {type(start).__name__}")
    map = connect_lanes(validate_map(start))
    if at is None and map.routes:
        return map, map.routes[0].lane_ids[0]
    if at is None and not map.tiles:
        raise ValueError("at is missing: say where on the map the route begins, as x, y [m] and direction [rad]")
    x, y, yaw = (map.tiles[0].x, map.tiles[0].y, map.tiles[0].yaw) if at is None else at
    return map, start_lane(map, *(finite_number(v, "at") for v in (x, y, yaw)))


def _conditions(condition: Any) -> list[Condition]:
    if condition is None or isinstance(condition, Condition | str):
        return [open_condition(condition)]
    if not isinstance(condition, Sequence) or not len(condition):
        raise ValueError("condition must be a scjax.Condition, a text, or a sequence of them, one for each tile")
    return [open_condition(one) for one in condition]


def _way(route: Any) -> str | Float64[np.ndarray, "points 2"]:
    if isinstance(route, str):
        if route not in ROUTES:
            raise ValueError(f"route is {route[:60]!r}: give {' or '.join(ROUTES)}, or points x, y to pass")
        return route
    try:
        points = np.asarray(route, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError("route must be a name or points x, y [m] to pass") from error
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise ValueError("route must be a name or at least two points x, y [m] to pass")
    return points


def _checked_area(area: Any) -> tuple[float, float, float, float]:
    if len(area) != 4:
        raise ValueError("area must be x_min, x_max, y_min, y_max [m]")
    x_min, x_max, y_min, y_max = (finite_number(value, "area") for value in area)
    if not (x_min < x_max and y_min < y_max):
        raise ValueError(f"area is {(x_min, x_max, y_min, y_max)}: give x_min < x_max and y_min < y_max")
    return x_min, x_max, y_min, y_max


def _inside(pose: WindowPose, area: tuple[float, float, float, float]) -> bool:
    x_min, x_max, y_min, y_max = area
    return x_min <= pose.x <= x_max and y_min <= pose.y <= y_max
