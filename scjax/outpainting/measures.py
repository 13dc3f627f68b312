"""How good a map of tiles is: dead ends, connected share, joints at seams."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from scjax.outpainting.coverage import AHEAD, Coverage, OpenEnd
from scjax.scene import AgentType, Map, TileStatus, measure_seam
from scjax.scene.angles import wrap_to_pi
from scjax.scene.boxes import overlaps
from scjax.scene.polyline import cumulative_length, spread_points

NEAR_SEAM = 8.0
"""m from a seam, within which a place counts as at it."""

_STEP = 0.25  # m between points of lanes whose directions are compared
_ON_LANE, _OWN_WAY = 1.0, np.deg2rad(60.0)  # m and rad; of vehicles on a lane of their direction
_SHARP = np.deg2rad(25.0)  # change of direction within a meter, from which a lane is kinked


class ZoneMeasures(NamedTuple):
    """Measures of the part of a map that is near its seams, or of the rest.

    Attributes:
      length: of its lanes [m].
      ends, dead_ends: ends of lanes, and those of them to which nothing is connected, on covered ground.
      kinks: meters of lanes within which the direction changes by more than 25 degrees.
      agents, overlapping: agents, and those of them whose boxes share ground with another one.
      vehicles, beside: vehicles, and those of them more than 1 m from every lane of their direction.
    """

    length: float
    ends: int
    dead_ends: int
    kinks: int
    agents: int
    overlapping: int
    vehicles: int
    beside: int


class MapMeasures(NamedTuple):
    """Measures of one map.

    Attributes:
      length: of all lanes [m].
      dead_ends: ends of lanes on covered ground to which nothing is connected.
      largest_share: share of the length that is in the largest component; lanes that follow each other or lie beside
        each other are connected.
      gaps, turns: of the connections at seams [m, rad].
      signaled, differing: connections at seams whose lanes both have a signal, and those of them with two states.
      complete, tiles: generated tiles without a fault on whose ground no lane ends dead, and all that are there.
      missing: places of tiles at which none is there, since nothing went on or it was taken back.
      attempts: candidates that were generated, for missing tiles too.
      overlapping: vehicles and other agents whose boxes share ground with another one.
    """

    length: float
    dead_ends: int
    largest_share: float
    gaps: Float64[np.ndarray, " connections"]
    turns: Float64[np.ndarray, " connections"]
    signaled: int
    differing: int
    complete: int
    tiles: int
    missing: int
    attempts: int
    overlapping: int


def measure_map(map: Map) -> MapMeasures:
    """Measures of a map with at least one lane."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    row_of = {lane.id: row for row, lane in enumerate(map.lanes)}
    lengths = np.array([cumulative_length(lane.points)[-1] for lane in map.lanes])
    pairs = [
        (row_of[lane.id], row_of[other])
        for lane in map.lanes
        for other in (*lane.successors, *(n.lane_id for n in (*lane.left_neighbors, *lane.right_neighbors)))
        if other in row_of
    ]
    rows, columns = np.array(pairs, int).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(lengths),) * 2)
    _, component = connected_components(graph, directed=False)
    joints = [measure_seam(map, seam) for seam in map.seams]
    generated = [tile for tile in map.tiles if tile.status != TileStatus.KNOWN]
    states = dict(zip(map.signal_lane_ids, map.signal_states.tolist(), strict=True))
    met = [(states[a], states[b]) for seam in map.seams for a, b in seam.connections if a in states and b in states]
    dead_ends = _dead_ends(map)
    beyond = np.array([end.place[:2] + AHEAD * _direction(end.outward) for end in dead_ends]).reshape(-1, 2)
    return MapMeasures(
        length=float(lengths.sum()),
        dead_ends=len(dead_ends),
        largest_share=float(np.bincount(component, lengths).max() / max(lengths.sum(), 1e-9)),
        gaps=np.concatenate([np.zeros(0), *(joint.gaps for joint in joints)]),
        turns=np.concatenate([np.zeros(0), *(joint.turns for joint in joints)]),
        signaled=len(met),
        differing=sum(a != b for a, b in met),
        complete=sum(
            tile.status == TileStatus.COMPLETE and not Coverage(Map(lanes=(), tiles=(tile,))).contains(beyond).any()
            for tile in generated
        ),
        tiles=sum(tile.status != TileStatus.MISSING for tile in generated),
        missing=sum(tile.status == TileStatus.MISSING for tile in generated),
        attempts=sum(tile.attempts for tile in generated),
        overlapping=int(_boxes(map)[1].sum()),
    )


def measure_zones(map: Map) -> tuple[ZoneMeasures, ZoneMeasures]:
    """Measures of the ground within ``NEAR_SEAM`` of a seam, and of all other ground."""
    seams = np.array([(*seam.start, *seam.end) for seam in map.seams]).reshape(-1, 4)
    boxes, is_overlap = _boxes(map)
    vehicles, is_beside = _beside_lanes(map)
    none = np.zeros((0, 2))
    places = (  # in the order of ``ZoneMeasures``
        np.concatenate([none, *(spread_points(lane.points[:, :2]) for lane in map.lanes)]),
        np.concatenate([none, *(lane.points[[0, -1], :2] for lane in map.lanes)]),
        np.concatenate([none, *(end.place[None, :2] for end in _dead_ends(map))]),
        np.concatenate([none, *(kinks_of(lane.points) for lane in map.lanes)]),
        boxes[:, :2],
        boxes[is_overlap, :2],
        vehicles,
        vehicles[is_beside],
    )
    near = [_is_near(some, seams) for some in places]
    counts = [(int(one.sum()), int((~one).sum())) for one in near]
    (length, *rest), (other_length, *others) = zip(*counts, strict=True)
    return ZoneMeasures(float(length), *rest), ZoneMeasures(float(other_length), *others)


def _dead_ends(map: Map) -> list[OpenEnd]:
    """Ends of lanes on covered ground to which nothing is connected."""
    return [end for end in Coverage(map).open_ends(map) if not end.at_border]


def _boxes(map: Map) -> tuple[Float64[np.ndarray, "boxes 9"], Bool[np.ndarray, " boxes"]]:
    """Agents of known size, and whether each shares ground with another one."""
    boxes = map.agents[~np.isnan(map.agents[:, 6:8]).any(-1)]
    return boxes, np.any(overlaps(boxes), axis=-1) if len(boxes) else np.zeros(0, bool)


def _beside_lanes(map: Map) -> tuple[Float64[np.ndarray, "vehicles 2"], Bool[np.ndarray, " vehicles"]]:
    """Places of vehicles, and whether each is more than 1 m from every lane of its direction."""
    from scipy.spatial import KDTree

    vehicles = map.agents[map.agent_types == AgentType.VEHICLE]
    lines = [spread_points(lane.points[:, :2], _STEP) for lane in map.lanes]
    lines = [line for line in lines if len(line) > 1]
    if not len(vehicles) or not lines:
        return vehicles[:, :2], np.ones(len(vehicles), bool)
    points, steps = (np.concatenate(some) for some in (lines, [np.gradient(line, axis=0) for line in lines]))
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    own = np.arctan2(vehicles[:, 5], vehicles[:, 4])
    near = KDTree(points).query_ball_point(vehicles[:, :2], _ON_LANE)
    on_lane = [(np.abs(wrap_to_pi(headings[rows] - yaw)) < _OWN_WAY).any() for rows, yaw in zip(near, own, strict=True)]
    return vehicles[:, :2], ~np.array(on_lane, bool)


def _direction(heading: float) -> Float64[np.ndarray, " 2"]:
    return np.array([np.cos(heading), np.sin(heading)])


def kinks_of(line: Float64[np.ndarray, "points _"], within: float = 1.0) -> Float64[np.ndarray, "kinks 2"]:
    """The places of a line at which its direction changes by more than 25 degrees within a length [m]."""
    steps = np.diff(spread_points(line[:, :2], _STEP), axis=0)
    steps = steps[np.hypot(*steps.T) > _STEP / 4]  # the last one may be of no length
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    far = round(within / _STEP)
    sharp = np.zeros(len(headings), bool)
    for apart in range(1, min(far, len(headings) - 1) + 1):
        sharp[:-apart] |= np.abs(wrap_to_pi(headings[apart:] - headings[:-apart])) > _SHARP
    places = line[0, :2] + np.cumsum(steps, axis=0)
    return places[sharp][::far]


def _is_near(points: Float64[np.ndarray, "n 2"], seams: Float64[np.ndarray, "seams 4"]) -> Bool[np.ndarray, " n"]:
    """Whether points are within ``NEAR_SEAM`` of one of the line segments."""
    near = np.zeros(len(points), bool)
    for start_end in seams:
        start, way = start_end[:2], start_end[2:] - start_end[:2]
        share = np.clip((points - start) @ way / max(float(way @ way), 1e-9), 0.0, 1.0)
        near |= np.hypot(*(points - start - share[:, None] * way).T) < NEAR_SEAM
    return near
