"""Windows on a scene: a context of lanes and agents in the ego's frame -> the ``Scene`` seen through one layout."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from scjax.data import ragged
from scjax.scene import MAX_AGENTS, MAX_LANES, POINTS_PER_LANE, TILE_SIZE, Crop, Link, Scene

HALF = TILE_SIZE / 2
WINDOWS = {  # x_min, x_max, y_min, y_max in metres, edges included
    Crop.CENTERED: (-HALF, HALF, -HALF, HALF),
    Crop.PARTITIONED: (-HALF, HALF, -HALF, HALF),
    Crop.FORWARD: (0.0, TILE_SIZE, -HALF, HALF),
}
SIDE_BY_SIDE = 2.0  # metres that two pieces must share to be neighbours, or half of the shorter piece


@dataclasses.dataclass(frozen=True)
class Context:
    """Everything around one pose, in its frame (x forward, y left, z above the ground under the ego).

    Lanes are ragged, in driving direction; ``edges``, ``beside`` and ``spans`` as in ``LaneGraph``. Agents have the
    nine columns of ``Scene.agents``, the ego first, then by distance; unknown values are filled and flagged.
    ``off_road`` marks vehicles more than 2.5 m from every centreline.
    """

    points: Float[np.ndarray, "points 3"]
    offsets: Int[np.ndarray, " offsets"]
    lane_z_known: Bool[np.ndarray, " lanes"]
    edges: Int[np.ndarray, "edges 2"]
    beside: Int[np.ndarray, "pairs 2"]
    spans: Float[np.ndarray, "pairs 4"]
    signals: Integer[np.ndarray, " lanes"]
    agents: Float[np.ndarray, "agents 9"]
    agent_types: Integer[np.ndarray, " agents"]
    agent_known: Bool[np.ndarray, "agents 9"]
    off_road: Bool[np.ndarray, " agents"]


def neighbour_pieces(
    pieces: ragged.Pieces,
    beside: Int[np.ndarray, "pairs 2"],
    spans: Float[np.ndarray, "pairs 4"],
    count: int,
    overlap: float = SIDE_BY_SIDE,
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (left, right) of pieces that are side by side [pairs, 2] and their spans on the pieces [pairs, 4], metres.

    Args:
      beside, spans: those of the ``count`` polylines the pieces were cut from.
      overlap: metres that two pieces must share (or half of the shorter one).
    """
    relation = np.full((count, count), -1, np.int16)
    relation[beside[:, 0], beside[:, 1]] = np.arange(len(beside))
    among = relation[pieces.source[:, None], pieces.source[None, :]]
    left, right = np.nonzero(among >= 0)
    if not left.size:
        return np.zeros((0, 2), np.int64), np.zeros((0, 4))
    span = spans[among[left, right]].astype(np.float64)
    scale = (span[:, 3] - span[:, 2]) / np.maximum(span[:, 1] - span[:, 0], 1e-6)
    arc_left, arc_right = pieces.arc[left], pieces.arc[right]
    # The right piece's extent, carried over to the left lane.
    back = span[:, :1] + (arc_right - span[:, 2:3]) / np.maximum(scale, 1e-6)[:, None]
    low = np.maximum(np.maximum(span[:, 0], arc_left[:, 0]), back[:, 0])
    high = np.minimum(np.minimum(span[:, 1], arc_left[:, 1]), back[:, 1])
    length = np.minimum(arc_left[:, 1] - arc_left[:, 0], arc_right[:, 1] - arc_right[:, 0])
    enough = high - low >= np.minimum(overlap, 0.5 * length)
    enough &= high > low
    own = np.stack([low, high], -1)
    other = span[:, 2:3] + (own - span[:, :1]) * scale[:, None]
    shared = np.concatenate([own - arc_left[:, :1], other - arc_right[:, :1]], -1)
    return np.stack([left, right], -1)[enough], shared[enough]


def crop_scene(
    context: Context,
    crop: Crop = Crop.CENTERED,
    *,
    dx: float = 0.0,
    dy: float = 0.0,
    dyaw: float = 0.0,
    domain: int = 0,
    off_road: bool = False,
    max_agents: int = MAX_AGENTS,
    max_lanes: int = MAX_LANES,
) -> Scene:
    """The unpadded NumPy scene seen through the window of ``crop``.

    Lanes are clipped exactly, pieces shorter than 0.5 m dropped unless they are whole lanes, resampled to 20 points and
    ordered by distance to the origin; agents are those whose centre is inside, the ego first, then by distance. Of more
    than ``max_lanes`` or ``max_agents`` the nearest are kept.

    Args:
      dx, dy, dyaw: where the window's origin lies in the context's frame [m, rad]. The ego stays agent 0
        wherever that leaves it, even outside the window: every scene has an ego.
      off_road: keep vehicles parked off the road.
    """
    points, heading = context.points, None
    if dx or dy or dyaw:
        heading = np.cos(dyaw), np.sin(dyaw)
        points = _move(points, dx, dy, *heading)
    pieces = ragged.clip(points, context.offsets, WINDOWS[crop], cut=crop == Crop.PARTITIONED)
    lanes = ragged.resample(pieces, POINTS_PER_LANE)
    order = ragged.nearest_first(lanes)[:max_lanes]
    source = pieces.source[order]
    agents = context.agents
    if heading is not None:
        cos, sin = heading
        agents = _move(agents, dx, dy, cos, sin)
        agents[:, 4] = cos * context.agents[:, 4] + sin * context.agents[:, 5]
        agents[:, 5] = cos * context.agents[:, 5] - sin * context.agents[:, 4]
    rows = _visible(agents, context.off_road, crop, off_road, moved=heading is not None)[:max_agents]
    lane_known = np.ones((len(order), 3), bool)
    lane_known[:, 2] = context.lane_z_known[source]
    return Scene(
        agents=agents[rows].astype(np.float32),
        agent_types=context.agent_types[rows].astype(np.int32),
        agent_mask=np.ones(len(rows), bool),
        agent_known=context.agent_known[rows],
        lanes=lanes[order].astype(np.float32),
        lane_mask=np.ones(len(order), bool),
        lane_known=lane_known,
        signals=context.signals[source].astype(np.int32),
        links=_links(pieces, context)[np.ix_(order, order)],
        crop=np.asarray(crop, np.int32),
        domain=np.asarray(domain, np.int32),
    )


def _move(values: np.ndarray, dx: float, dy: float, cos: float, sin: float) -> np.ndarray:
    moved = values.astype(np.float64)
    x, y = moved[:, 0] - dx, moved[:, 1] - dy
    moved[:, 0], moved[:, 1] = cos * x + sin * y, cos * y - sin * x
    return moved


def _visible(agents: np.ndarray, parked: np.ndarray, crop: Crop, off_road: bool, moved: bool) -> np.ndarray:
    x_min, x_max, y_min, y_max = WINDOWS[crop]
    x, y = agents[:, 0], agents[:, 1]
    rows = (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)
    if not off_road:
        rows &= ~parked
    rows[:1] = True
    rows = np.flatnonzero(rows)
    if not moved:
        return rows
    distance = x[rows] * x[rows] + y[rows] * y[rows]
    distance[rows == 0] = -1.0
    return rows[np.argsort(distance, kind="stable")]


def _links(pieces: ragged.Pieces, context: Context) -> Int[np.ndarray, "pieces pieces"]:
    count = len(context.offsets) - 1
    links = np.zeros((len(pieces.source),) * 2, np.int32)
    beside, _ = neighbour_pieces(pieces, context.beside, context.spans, count)
    links[beside[:, 0], beside[:, 1]] = Link.LEFT
    links[beside[:, 1], beside[:, 0]] = Link.RIGHT
    edges = ragged.piece_edges(pieces, context.edges, count)
    links[edges[:, 1], edges[:, 0]] = Link.SUCCESSOR
    links[edges[:, 0], edges[:, 1]] = Link.PREDECESSOR  # last: two lanes may precede each other
    np.fill_diagonal(links, Link.SELF)
    return links
