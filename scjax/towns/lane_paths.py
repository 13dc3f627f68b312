"""SUMO's lanes on our lanes: where each position on a lane of SUMO lies on the centerlines of our own reading.

Lanes outside of junctions are matched by geometry, among the lanes of the road that SUMO names. Ways through junctions
are matched by what they connect, since SUMO draws its own curves there.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Float64

from scjax.data.readers.opendrive.lane_lines import LaneKey
from scjax.data.readers.opendrive.road_map import RoadMap
from scjax.scene.angles import wrap_to_pi
from scjax.scene.polyline import cumulative_length
from scjax.towns.sumo_network import SumoConnection, SumoLane, SumoNetwork

MAX_OFFSET = 4.0  # m between a lane of SUMO and ours; SUMO shifts lanes where another one opens
_OTHER_LANE = 3.0  # m that a lane of another id than SUMO names must be nearer
_MAX_ANGLE = np.deg2rad(60.0)
_STEP = 0.5  # m between places that are matched
_MAX_LANES = 8  # of a way through a junction
_MAX_STRETCH = 2.0  # of lengths; SUMO gives lanes of one edge one length, even if one is far shorter


@dataclasses.dataclass(frozen=True)
class LanePath:
    """A row of our lanes that a lane of SUMO lies on.

    Attributes:
      keys: the lanes, in driving direction.
      points: their centerlines as one [m].
      arcs: position of each point along the path, in the plane [m].
      positions, places: positions on SUMO's lane [m] and the places on the path that they mean [m], both increasing.
      offset: mean distance between both centerlines [m]; NaN in junctions.
    """

    keys: tuple[LaneKey, ...]
    points: Float64[np.ndarray, "points 3"]
    arcs: Float64[np.ndarray, " points"]
    positions: Float64[np.ndarray, " knots"]
    places: Float64[np.ndarray, " knots"]
    offset: float

    def at(self, positions: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 4"]:
        """x, y, z [m] and heading [rad] of positions on SUMO's lane."""
        return self.at_places(np.interp(positions, self.positions, self.places))

    def at_places(self, places: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 4"]:
        """x, y, z [m] and heading [rad] at places on the path; straight on beyond its ends."""
        row = np.clip(np.searchsorted(self.arcs, places, side="right") - 1, 0, len(self.arcs) - 2)
        step = self.points[row + 1] - self.points[row]
        share = ((places - self.arcs[row]) / (self.arcs[row + 1] - self.arcs[row]))[:, None]
        heading = np.arctan2(step[:, 1], step[:, 0])
        return np.concatenate([self.points[row] + share * step, heading[:, None]], 1)


def match_lanes(network: SumoNetwork, road_map: RoadMap, is_for_cars: Callable[[LaneKey], bool]) -> dict[str, LanePath]:
    """The path of every lane of SUMO for cars that lies on our lanes, by the id of the lane."""
    of_road: dict[str, list[LaneKey]] = defaultdict(list)
    for key in road_map.lines:
        if is_for_cars(key):
            of_road[key.road].append(key)
    paths: dict[str, LanePath] = {}
    for lane in network.lanes.values():
        if lane.has_cars and not lane.is_internal and lane.origin is not None and len(lane.points) > 1:
            path = _match_by_geometry(lane, of_road[lane.origin[0]], road_map)
            if path is not None:
                paths[lane.id] = path
    for connection in network.connections:
        paths |= _match_junction(connection, network, road_map, paths)
    return paths


def _match_by_geometry(lane: SumoLane, candidates: list[LaneKey], road_map: RoadMap) -> LanePath | None:
    arcs = cumulative_length(lane.points)
    samples = np.linspace(0.0, arcs[-1], max(int(arcs[-1] / _STEP), 1) + 1)
    xy = np.stack([np.interp(samples, arcs, column) for column in lane.points.T], -1)
    step = np.gradient(xy, axis=0) if len(xy) > 1 else np.zeros_like(xy)
    heading = np.arctan2(step[:, 1], step[:, 0])
    distances = np.full((len(candidates), len(xy)), np.inf)
    for row, key in enumerate(candidates):
        distance, place, direction = project(xy, road_map.lines[key].points)
        turn = np.abs(wrap_to_pi(direction - heading))
        distance = distance + (0.0 if lane.origin is None or key.lane == lane.origin[1] else _OTHER_LANE)
        distances[row] = np.where(turn < _MAX_ANGLE, distance, np.inf)
    if not len(candidates) or not (distances.min(0) < MAX_OFFSET).any():
        return None
    nearest = distances.argmin(0)[distances.min(0) < MAX_OFFSET]
    keys = _connected([candidates[row] for row in dict.fromkeys(nearest)], road_map)
    points, arc = _joined(keys, road_map)
    distance, place, _ = project(xy, points)
    places = np.maximum.accumulate(place)
    positions = samples * lane.length / arcs[-1]
    if lane.length > 1.0 and not 1 / _MAX_STRETCH < (places[-1] - places[0]) / lane.length < _MAX_STRETCH:
        return None
    return LanePath(tuple(keys), points, arc, positions, places, float(distance.mean()))


def _connected(keys: list[LaneKey], road_map: RoadMap) -> list[LaneKey]:
    """The longest run of ``keys`` that follow each other."""
    runs: list[list[LaneKey]] = [[keys[0]]]
    for key in keys[1:]:
        if key in road_map.successors.get(runs[-1][-1], ()):
            runs[-1].append(key)
        else:
            runs.append([key])
    return max(runs, key=lambda run: sum(road_map.lines[key].length for key in run))


def _match_junction(
    connection: SumoConnection, network: SumoNetwork, road_map: RoadMap, paths: dict[str, LanePath]
) -> dict[str, LanePath]:
    """Paths of the lanes in a junction, from the lane before it to the lane behind it."""
    before, behind = paths.get(connection.source), paths.get(connection.target)
    if before is None or behind is None or not connection.via:
        return {}
    keys = find_way(before.keys[-1], behind.keys[0], road_map)
    if keys is None:
        return {}
    keys = [*before.keys[:-1], *keys, *behind.keys[1:]]
    points, arc = _joined(keys, road_map)
    start = float(before.places[-1])
    skipped = sum(road_map.lines[key].length for key in keys[: len(keys) - len(behind.keys)])
    end = skipped + float(behind.places[0])
    lengths = np.array([network.lanes[via].length for via in connection.via])
    bounds = start + (end - start) * np.concatenate([[0.0], np.cumsum(lengths)]) / max(lengths.sum(), 1e-6)
    if end < start:
        return {}
    return {
        via: LanePath(tuple(keys), points, arc, np.array([0.0, max(length, 1e-6)]), bounds[k : k + 2], float("nan"))
        for k, (via, length) in enumerate(zip(connection.via, lengths, strict=True))
    }


def find_way(start: LaneKey, goal: LaneKey, road_map: RoadMap) -> list[LaneKey] | None:
    """The shortest way by number of lanes, both ends included; None if there is none of up to eight lanes."""
    ways = [[start]]
    seen = {start}
    while ways:
        way = ways.pop(0)
        if way[-1] == goal:
            return way
        if len(way) < _MAX_LANES:
            fresh = [key for key in road_map.successors.get(way[-1], ()) if key not in seen]
            seen.update(fresh)
            ways += [[*way, key] for key in fresh]
    return None


def _joined(keys: Iterable[LaneKey], road_map: RoadMap) -> tuple[np.ndarray, np.ndarray]:
    """Centerlines in a row as one polyline without repeated points, and its arc lengths."""
    points = np.concatenate([road_map.lines[key].points for key in keys])
    step = np.hypot(*np.diff(points[:, :2], axis=0).T)
    points = points[np.concatenate([[True], step > 1e-3])]
    return points, cumulative_length(points)


def project(xy: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance [m] of each of ``xy`` to a polyline, arc length [m] and heading [rad] of the nearest place, [n] each."""
    start, step = points[:-1, :2], np.diff(points[:, :2], axis=0)
    squared = np.maximum((step * step).sum(-1), 1e-12)
    distance, place, heading = (np.empty(len(xy)) for _ in range(3))
    arcs, headings = cumulative_length(points), np.arctan2(step[:, 1], step[:, 0])
    for rows in np.array_split(np.arange(len(xy)), max(1, len(xy) * len(step) // 1_000_000 + 1)):
        offset = xy[rows, None] - start
        share = np.clip((offset * step).sum(-1) / squared, 0.0, 1.0)
        away = np.hypot(*np.moveaxis(offset - share[..., None] * step, -1, 0))
        best = away.argmin(1)
        row = np.arange(len(rows))
        distance[rows], heading[rows] = away[row, best], headings[best]
        place[rows] = arcs[best] + share[row, best] * np.sqrt(squared[best])
    return distance, place, heading
