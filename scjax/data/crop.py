"""A local map -> the ``Scene`` inside one crop window."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from scjax.data import ragged
from scjax.data.local_map import LocalMap, neighbor_pieces
from scjax.scene import MAX_AGENTS, MAX_LANES, POINTS_PER_LANE, TILE_SIZE, Crop, Link, Scene

HALF = TILE_SIZE / 2
WINDOWS = {  # x_min, x_max, y_min, y_max [m], edges included
    Crop.CENTERED: (-HALF, HALF, -HALF, HALF),
    Crop.PARTITIONED: (-HALF, HALF, -HALF, HALF),
    Crop.FORWARD: (0.0, TILE_SIZE, -HALF, HALF),
}


def crop_scene(
    local_map: LocalMap,
    crop: Crop = Crop.CENTERED,
    *,
    dx: float = 0.0,
    dy: float = 0.0,
    dyaw: float = 0.0,
    domain: int = 0,
    off_road: bool = False,
    has_ego: bool = True,
    max_agents: int = MAX_AGENTS,
    max_lanes: int = MAX_LANES,
) -> Scene:
    """The unpadded NumPy scene inside the window of ``crop``.

    Lanes are clipped exactly, resampled to 20 points and ordered by distance to the origin. Pieces shorter than 0.5 m
    are dropped unless they are whole lanes. Agents are those whose center is inside, the ego first, then by distance.
    Of more than ``max_lanes`` or ``max_agents`` the nearest are kept.

    Args:
      dx, dy, dyaw: pose of the window's origin in the frame of ``local_map`` [m, rad]. The ego stays agent 0 even
        outside the window: every scene has an ego.
      domain: index of the data set, for ``Scene.domain``.
      off_road: keep vehicles parked off the road.
      has_ego: whether the first agent of ``local_map`` is an ego; without one, agent 0 is the nearest.
    """
    points, rotation = local_map.points, None
    if dx or dy or dyaw:
        rotation = np.cos(dyaw), np.sin(dyaw)
        points = _to_window(points, dx, dy, *rotation)
    pieces = ragged.clip_polylines(points, local_map.offsets, WINDOWS[crop], cut=crop == Crop.PARTITIONED)
    lanes = ragged.resample_pieces(pieces, POINTS_PER_LANE)
    order = ragged.order_by_distance(lanes)[:max_lanes]
    source = pieces.source[order]
    agents = local_map.agents
    if rotation is not None:
        cos, sin = rotation
        agents = _to_window(agents, dx, dy, cos, sin)
        agents[:, 4] = cos * local_map.agents[:, 4] + sin * local_map.agents[:, 5]
        agents[:, 5] = cos * local_map.agents[:, 5] - sin * local_map.agents[:, 4]
    dropped = np.zeros(len(agents), bool) if off_road else local_map.off_road
    rows = _agents_inside(agents, dropped, crop, rotation is not None, has_ego)[:max_agents]
    lane_known = np.ones((len(order), 3), bool)
    lane_known[:, 2] = local_map.lane_z_known[source]
    return Scene(
        agents=agents[rows].astype(np.float32),
        agent_types=local_map.agent_types[rows].astype(np.int32),
        agent_mask=np.ones(len(rows), bool),
        agent_known=local_map.agent_known[rows],
        lanes=lanes[order].astype(np.float32),
        lane_mask=np.ones(len(order), bool),
        lane_known=lane_known,
        signals=local_map.signals[source].astype(np.int32),
        links=_links(pieces, local_map)[np.ix_(order, order)],
        crop=np.asarray(crop, np.int32),
        domain=np.asarray(domain, np.int32),
    )


def _to_window(values: np.ndarray, dx: float, dy: float, cos: float, sin: float) -> np.ndarray:
    """Rows whose first two columns are x, y, in the frame of the window."""
    moved = values.astype(np.float64)
    x, y = moved[:, 0] - dx, moved[:, 1] - dy
    moved[:, 0], moved[:, 1] = cos * x + sin * y, cos * y - sin * x
    return moved


def _agents_inside(agents: np.ndarray, dropped: np.ndarray, crop: Crop, moved: bool, has_ego: bool) -> np.ndarray:
    """Rows of the agents inside the window: the ego, if there is one, then the others by distance."""
    x_min, x_max, y_min, y_max = WINDOWS[crop]
    x, y = agents[:, 0], agents[:, 1]
    inside = (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max) & ~dropped
    inside[:1] |= has_ego
    rows = np.flatnonzero(inside)
    if not moved:  # a local map has them in this order already
        return rows
    distance = x[rows] * x[rows] + y[rows] * y[rows]
    distance[(rows == 0) & has_ego] = -1.0
    return rows[np.argsort(distance, kind="stable")]


def _links(pieces: ragged.ClippedPolylines, local_map: LocalMap) -> Int[np.ndarray, "pieces pieces"]:
    count = len(local_map.offsets) - 1
    links = np.zeros((len(pieces.source),) * 2, np.int32)
    neighbors, _ = neighbor_pieces(pieces, local_map.neighbors, local_map.overlap_spans, count)
    links[neighbors[:, 0], neighbors[:, 1]] = Link.LEFT
    links[neighbors[:, 1], neighbors[:, 0]] = Link.RIGHT
    edges = ragged.piece_successors(pieces, local_map.successors, count)
    links[edges[:, 1], edges[:, 0]] = Link.SUCCESSOR
    links[edges[:, 0], edges[:, 1]] = Link.PREDECESSOR  # last: two lanes may precede each other
    np.fill_diagonal(links, Link.SELF)
    return links
