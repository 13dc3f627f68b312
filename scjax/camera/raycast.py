"""Ray-caster: semantic classes and depth of a scene, as a camera at the ego sees it ahead.

Training on images without photographs uses the result in the place of image features.

The pinhole camera is 1.5 m above the origin of a forward crop and looks along x. Its half angle of 50 degrees is the
field of view in which the paper's loss and ``metrics.placement.cone`` expect agents. It reaches the sides of the crop
27 m ahead and covers four fifths of it. Vertically the view goes from slope -0.5 (the ground 3 m ahead) to slope 0.2.
Cells are not square then, as in the release, which squeezes wide pictures onto the same grid. Square cells would hold
all ground from 9 m on in one row.

The world is flat: lanes are ribbons of one width and boxes stand on the ground, since scenes hold no terrain between
lanes. The ego is invisible. What lies beyond the crop, and the sky, is of class "nothing".
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from scjax.scene import TILE_SIZE, AgentType, Crop, Scene

CLASSES = (*(agent_type.name.lower() for agent_type in AgentType), "lane", "ground", "nothing")
LANE, GROUND, NOTHING = len(AgentType), len(AgentType) + 1, len(AgentType) + 2
GRID = (14, 14)  # rows and columns of cells, as of the image encoder's patches
RAYS_PER_CELL = (4, 8)  # rows and columns; a person 20 m ahead is one ray wide
CAMERA_HEIGHT = 1.5  # m above the ground
HALF_ANGLE = 50.0  # degrees
MAX_SLOPE, MIN_SLOPE = 0.2, -0.5  # of the picture's upper and lower edge
MAX_DEPTH = TILE_SIZE  # m; larger depths are this
LANE_WIDTH = 3.5  # m; scenes hold no widths

_CELL_SIZE = 0.5  # m, of the ground map
_MAP_SIZE = int(TILE_SIZE / _CELL_SIZE)  # cells
_SAMPLES_ALONG, _SAMPLES_ACROSS = 192, 8  # of a lane's ribbon, closer than the map's cells up to 96 m


class RayHits(NamedTuple):
    """What each ray hits first: its index in ``CLASSES``, and its depth, the distance along x [m]; upper left first."""

    classes: Int[np.ndarray, "rows columns"]
    depth: Float[np.ndarray, "rows columns"]


class SemanticDepth(NamedTuple):
    """Shares of ``CLASSES`` among the rays of each ``GRID`` cell, and their mean depth divided by ``MAX_DEPTH``."""

    image: Float32[np.ndarray, "classes 14 14"]
    depth: Float32[np.ndarray, "14 14"]


def render(scene: Scene) -> SemanticDepth:
    """Semantic classes and depth ahead of the ego, per cell.

    Args:
      scene: one NumPy scene in the forward crop.

    Raises:
      ValueError: as ``cast_rays``.
    """
    hits = cast_rays(scene)
    rows, columns = GRID
    shape = (rows, RAYS_PER_CELL[0], columns, RAYS_PER_CELL[1])
    one_hot = hits.classes.reshape(1, *shape) == np.arange(len(CLASSES)).reshape(-1, 1, 1, 1, 1)
    depth = hits.depth.reshape(shape).mean((1, 3)) / MAX_DEPTH
    return SemanticDepth(one_hot.mean((2, 4), dtype=np.float32), depth.astype(np.float32))


def cast_rays(scene: Scene) -> RayHits:
    """The first hit of every ray in one NumPy scene; padding is invisible.

    Raises:
      ValueError: on a batch, or a scene in another crop than the forward one.
    """
    if scene.batch_shape or int(scene.crop) != Crop.FORWARD:
        actual = f"a batch {scene.batch_shape}" if scene.batch_shape else f"a {Crop(int(scene.crop)).name} scene"
        raise ValueError(f"a camera looks at one scene in the FORWARD crop, this is {actual}: crop it ahead")
    rays = ray_grid()
    lane_map = _lane_map(np.asarray(scene.lanes)[np.asarray(scene.lane_mask), :, :2])
    ground_depth = _ground_depth(rays.drop)[:, None]
    classes = np.where(rays.on_map, np.where(lane_map[rays.map_cell], LANE, GROUND), NOTHING)
    depth = np.where(rays.on_map, ground_depth, MAX_DEPTH).astype(np.float32)
    others = np.asarray(scene.agent_mask).copy()
    others[:1] = False
    agents = np.asarray(scene.agents, np.float64)[others]
    near, far = _box_crossings(agents, rays.lateral)
    visible = (near < far).any(0)
    if visible.any():
        box_depths = _box_depths(near[:, visible], far[:, visible], agents[visible, 8], rays.drop)
        first = box_depths.argmin(-1)
        nearest = np.take_along_axis(box_depths, first[..., None], -1)[..., 0]
        before_ground = nearest < ground_depth
        classes = np.where(before_ground, np.asarray(scene.agent_types)[others][visible][first], classes)
        depth = np.where(before_ground, np.minimum(nearest, MAX_DEPTH), depth)
    return RayHits(classes, depth)


class RayGrid(NamedTuple):
    """Directions of all rays, and where they meet the ground.

    Attributes:
      lateral: meters to the left per meter ahead, for each column.
      drop: meters down per meter ahead, for each row; negative above the horizon.
      map_cell: x and y index of the ground cell that each ray meets, 0 where there is none.
      on_map: whether a ray meets the ground inside the crop.
    """

    lateral: Float[np.ndarray, " columns"]
    drop: Float[np.ndarray, " rows"]
    map_cell: tuple[Int[np.ndarray, "rows columns"], Int[np.ndarray, "rows columns"]]
    on_map: Bool[np.ndarray, "rows columns"]


@functools.cache
def ray_grid() -> RayGrid:
    """The rays of the camera; the same for every scene."""
    rows, columns = GRID[0] * RAYS_PER_CELL[0], GRID[1] * RAYS_PER_CELL[1]
    lateral = np.tan(np.deg2rad(HALF_ANGLE)) * (1 - 2 * (np.arange(columns) + 0.5) / columns)
    drop = (MAX_SLOPE - MIN_SLOPE) * (np.arange(rows) + 0.5) / rows - MAX_SLOPE
    ahead = np.minimum(_ground_depth(drop)[:, None], 2 * MAX_DEPTH)
    x = np.floor(ahead / _CELL_SIZE).astype(int) + 0 * np.arange(columns)[None]
    y = np.floor((lateral[None] * ahead + TILE_SIZE / 2) / _CELL_SIZE).astype(int)
    on_map = (x < _MAP_SIZE) & (y >= 0) & (y < _MAP_SIZE)
    return RayGrid(lateral, drop, (np.where(on_map, x, 0), np.where(on_map, y, 0)), on_map)


def _ground_depth(drop: Float[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
    """Depth at which a ray meets the ground [m]; inf above the horizon."""
    return np.where(drop > 0, CAMERA_HEIGHT / np.where(drop > 0, drop, 1), np.inf)


def _box_crossings(
    agents: Float[np.ndarray, "agents 9"], lateral: Float[np.ndarray, " columns"]
) -> tuple[np.ndarray, np.ndarray]:
    """Depths [columns, agents] at which the upright plane of each column enters and leaves each box [m].

    Boxes behind the camera, around it or missed are entered at inf.
    """
    cos, sin = agents[None, :, 4], agents[None, :, 5]
    x, y = agents[None, :, 0], agents[None, :, 1]
    # Position of the camera and direction of the ray, along and across each box.
    origin = -x * cos - y * sin, x * sin - y * cos
    direction = cos + lateral[:, None] * sin, lateral[:, None] * cos - sin
    half_sizes = agents[None, :, 6] / 2, agents[None, :, 7] / 2
    spans = []
    for start, step, half in zip(origin, direction, half_sizes, strict=True):
        step = np.where(np.abs(step) < 1e-9, 1e-9, step)
        spans.append(np.sort([(-half - start) / step, (half - start) / step], axis=0))
    (near_along, far_along), (near_across, far_across) = spans
    near, far = np.maximum(near_along, near_across), np.minimum(far_along, far_across)
    return np.where((near > 0) & (near < far), near, np.inf), far


def _box_depths(
    near: Float[np.ndarray, "columns agents"],
    far: Float[np.ndarray, "columns agents"],
    height: Float[np.ndarray, " agents"],
    drop: Float[np.ndarray, " rows"],
) -> Float[np.ndarray, "rows columns agents"]:
    """Depth at which a ray meets a side of a box, or its top from above [m]; inf where it does neither."""
    near, far = near[None].astype(np.float32), far[None].astype(np.float32)
    drop = drop[:, None, None].astype(np.float32)
    height = height[None, None].astype(np.float32)
    meets_side = CAMERA_HEIGHT - drop * np.where(np.isinf(near), 0, near) <= height
    top = np.where(drop > 0, (CAMERA_HEIGHT - height) / np.where(drop > 0, drop, 1), np.inf)
    meets_top = (top >= near) & (top <= far)
    return np.where(meets_side, near, np.where(meets_top, top, np.inf))


def _lane_map(lanes: Float[np.ndarray, "lanes points 2"]) -> Bool[np.ndarray, "x y"]:
    """Which cells of the ground lie on a lane."""
    lane_map = np.zeros((_MAP_SIZE, _MAP_SIZE), bool)
    if not len(lanes):
        return lane_map
    tangents = np.gradient(lanes, axis=1)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=-1, keepdims=True), 1e-6)
    weights = _sample_weights(lanes.shape[1])
    middle, ahead = weights @ lanes, weights @ tangents
    left = np.stack([-ahead[..., 1], ahead[..., 0]], -1)
    offsets = np.linspace(-LANE_WIDTH / 2, LANE_WIDTH / 2, _SAMPLES_ACROSS, dtype=lanes.dtype)
    samples = middle[:, :, None] + offsets[None, None, :, None] * left[:, :, None]
    corner = np.array([0, TILE_SIZE / 2], lanes.dtype)
    cells = np.floor((samples + corner) / _CELL_SIZE).astype(np.int32).reshape(-1, 2)
    cells = cells[((cells >= 0) & (cells < _MAP_SIZE)).all(-1)]
    lane_map[cells[:, 0], cells[:, 1]] = True
    return lane_map


@functools.cache
def _sample_weights(points: int) -> Float32[np.ndarray, "along points"]:
    """Weights of the points of a polyline that give equally spaced samples by linear interpolation."""
    positions = np.linspace(0, points - 1, _SAMPLES_ALONG)
    low = np.minimum(positions.astype(int), points - 2)
    rows, share = np.arange(_SAMPLES_ALONG), positions - low
    weights = np.zeros((_SAMPLES_ALONG, points), np.float32)
    weights[rows, low], weights[rows, low + 1] = 1 - share, share
    return weights
