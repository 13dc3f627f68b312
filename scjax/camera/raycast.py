"""What a camera at the ego would see ahead, as classes and depth by ray casting: stands in for an image's features.

A pinhole camera 1.5 m above the origin of a forward window, looking along x. Its half angle of 50 degrees is the field
of view in which the paper's loss and ``metrics.placement.field_of_view`` expect agents: it reaches the sides of the window 27 m
ahead and holds four fifths of it. Upright it sees from the ground 3 m ahead (slope -0.5) to slope 0.2; cells are not
square then, as in the release, which squeezes wide pictures onto the same grid, but pictures of square cells would
hold all ground from 9 m on in one row.

The world it sees is flat: lanes are ribbons of one width, boxes stand on the ground, since scenes hold no terrain
between lanes. The ego is not seen. Nothing is known of what lies beyond the window, as of the sky.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from scjax.scene import TILE_SIZE, AgentType, Crop, Scene

CLASSES = (*(kind.name.lower() for kind in AgentType), "lane", "ground", "nothing")
LANE, GROUND, NOTHING = len(AgentType), len(AgentType) + 1, len(AgentType) + 2
GRID = (14, 14)
RAYS = (4, 8)  # rows and columns of rays in a cell; a person 20 m ahead is as wide as one
EYE = 1.5  # metres above the ground
HALF_ANGLE = 50.0  # degrees
UP, DOWN = 0.2, 0.5  # slopes of the picture's upper and lower edge
FAR = TILE_SIZE  # metres; larger depths are this
LANE_WIDTH = 3.5  # metres; scenes hold no widths

_CELL = 0.5  # metres of the ground's map
_CELLS = int(TILE_SIZE / _CELL)
_ALONG, _ACROSS = 192, 8  # samples of a lane's ribbon, closer than the map's cells up to 96 m


class View(NamedTuple):
    """One ray a pixel, from the upper left: the class that it hits, and its depth, the distance along x [m]."""

    kind: Int[np.ndarray, "rows columns"]
    depth: Float[np.ndarray, "rows columns"]


class StandIn(NamedTuple):
    """Shares of ``CLASSES`` among the rays of each cell of ``GRID``, and their mean depth over ``FAR``."""

    image: Float32[np.ndarray, "classes 14 14"]
    depth: Float32[np.ndarray, "14 14"]


def stand_in(scene: Scene) -> StandIn:
    """Of one NumPy scene in the forward layout; see ``look``."""
    view = look(scene)
    rows, columns = GRID
    shape = (rows, RAYS[0], columns, RAYS[1])
    hits = view.kind.reshape(1, *shape) == np.arange(len(CLASSES)).reshape(-1, 1, 1, 1, 1)
    depth = view.depth.reshape(shape).mean((1, 3)) / FAR
    return StandIn(hits.mean((2, 4), dtype=np.float32), depth.astype(np.float32))


def look(scene: Scene) -> View:
    """The nearest thing on every ray, of one NumPy scene; padding is not seen.

    Raises:
      ValueError: a batch, or a scene in another layout: the window must be the one ahead.
    """
    if scene.batch_shape or int(scene.crop) != Crop.FORWARD:
        found = f"a batch {scene.batch_shape}" if scene.batch_shape else f"a {Crop(int(scene.crop)).name} scene"
        raise ValueError(f"a camera looks at one scene in the FORWARD layout, this is {found}: crop it ahead")
    lateral, drop, at, on_ground = _rays()
    road = _lane_map(np.asarray(scene.lanes)[np.asarray(scene.lane_mask), :, :2])
    ground = np.where(drop > 0, EYE / np.where(drop > 0, drop, 1), np.inf)[:, None]
    kind = np.where(on_ground, np.where(road[at], LANE, GROUND), NOTHING)
    depth = np.where(on_ground, ground, FAR).astype(np.float32)
    others = np.asarray(scene.agent_mask).copy()
    others[:1] = False
    agents = np.asarray(scene.agents, np.float64)[others]
    near, far = _crossings(agents, lateral)
    seen = (near < far).any(0)
    if seen.any():
        hit = _box_depths(near[:, seen], far[:, seen], agents[seen, 8], drop)
        first = hit.argmin(-1)
        nearest = np.take_along_axis(hit, first[..., None], -1)[..., 0]
        box = nearest < ground
        kind = np.where(box, np.asarray(scene.agent_types)[others][seen][first], kind)
        depth = np.where(box, np.minimum(nearest, FAR), depth)
    return View(kind, depth)


@functools.cache
def _rays() -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray], Bool[np.ndarray, "rows columns"]]:
    """Metres to the left [columns] and down [rows] a metre ahead; the ground cell of each ray, and whether it is one
    of the window's."""
    rows, columns = GRID[0] * RAYS[0], GRID[1] * RAYS[1]
    lateral = np.tan(np.deg2rad(HALF_ANGLE)) * (1 - 2 * (np.arange(columns) + 0.5) / columns)
    drop = (UP + DOWN) * (np.arange(rows) + 0.5) / rows - UP
    ahead = np.where(drop > 0, EYE / np.where(drop > 0, drop, 1), np.inf)[:, None]
    x = np.floor(np.minimum(ahead, 2 * FAR) / _CELL).astype(int) + 0 * np.arange(columns)[None]
    y = np.floor((lateral[None] * np.minimum(ahead, 2 * FAR) + TILE_SIZE / 2) / _CELL).astype(int)
    inside = (x < _CELLS) & (y >= 0) & (y < _CELLS)
    return lateral, drop, (np.where(inside, x, 0), np.where(inside, y, 0)), inside


def _crossings(
    agents: Float[np.ndarray, "agents 9"], lateral: Float[np.ndarray, " columns"]
) -> tuple[np.ndarray, np.ndarray]:
    """Depths [columns, agents] at which the upright plane of each column enters and leaves each box.

    Behind the camera, around it or missed: entered at inf.
    """
    cos, sin = agents[None, :, 4], agents[None, :, 5]
    start = (-agents[None, :, 0] * cos - agents[None, :, 1] * sin, agents[None, :, 0] * sin - agents[None, :, 1] * cos)
    along = cos + lateral[:, None] * sin, lateral[:, None] * cos - sin
    spans = []
    for place, step, half in zip(start, along, (agents[None, :, 6] / 2, agents[None, :, 7] / 2), strict=True):
        step = np.where(np.abs(step) < 1e-9, 1e-9, step)
        spans.append(np.sort([(-half - place) / step, (half - place) / step], axis=0))
    (near, far), (near_aside, far_aside) = spans
    near, far = np.maximum(near, near_aside), np.minimum(far, far_aside)
    return np.where((near > 0) & (near < far), near, np.inf), far


def _box_depths(
    near: Float[np.ndarray, "columns agents"], far: Float[np.ndarray, "columns agents"],
    height: Float[np.ndarray, " agents"], drop: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, "rows columns agents"]:  # fmt: skip
    """Depth at which a ray meets a side of a box, or its top from above; inf where it does neither."""
    near, far = near[None].astype(np.float32), far[None].astype(np.float32)
    slope = drop[:, None, None].astype(np.float32)
    height = height[None, None].astype(np.float32)
    side = EYE - slope * np.where(np.isinf(near), 0, near) <= height
    top = np.where(slope > 0, (EYE - height) / np.where(slope > 0, slope, 1), np.inf)
    from_above = (top >= near) & (top <= far)
    return np.where(side, near, np.where(from_above, top, np.inf))


def _lane_map(lanes: Float[np.ndarray, "lanes points 2"]) -> Bool[np.ndarray, "x y"]:
    """Which cells of the ground lie on a lane."""
    road = np.zeros((_CELLS, _CELLS), bool)
    if not len(lanes):
        return road
    tangents = np.gradient(lanes, axis=1)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=-1, keepdims=True), 1e-6)
    weights = _between(lanes.shape[1])
    middle, ahead = weights @ lanes, weights @ tangents
    left = np.stack([-ahead[..., 1], ahead[..., 0]], -1)
    aside = np.linspace(-LANE_WIDTH / 2, LANE_WIDTH / 2, _ACROSS, dtype=lanes.dtype)
    places = middle[:, :, None] + aside[None, None, :, None] * left[:, :, None]
    cells = np.floor((places + np.array([0, TILE_SIZE / 2], lanes.dtype)) / _CELL).astype(np.int32).reshape(-1, 2)
    cells = cells[((cells >= 0) & (cells < _CELLS)).all(-1)]
    road[cells[:, 0], cells[:, 1]] = True
    return road


@functools.cache
def _between(points: int) -> Float32[np.ndarray, "along points"]:
    """Weights of equally spaced samples over a polyline's points."""
    at = np.linspace(0, points - 1, _ALONG)
    low = np.minimum(at.astype(int), points - 2)
    weights = np.zeros((_ALONG, points), np.float32)
    weights[np.arange(_ALONG), low], weights[np.arange(_ALONG), low + 1] = 1 - (at - low), at - low
    return weights
