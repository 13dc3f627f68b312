"""Buildings and trees beside the roads, which depend on a seed and the place alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Real

from scjax.camera.agent_boxes import box_corners_3d
from scjax.camera.dashcam.materials import COLORS, LEAVES, WALLS, Material, SemanticClass
from scjax.camera.dashcam.solids import (
    TOP,
    SolidPart,
    Solids,
    join_solids,
    no_solids,
    part_corners,
    part_materials,
    place_parts,
)
from scjax.scene import Log
from scjax.scene.polyline import spread_lines

_CELL = 14.0  # m; each cell of the ground has at most one thing
_AROUND = 45.0  # m beyond the lanes
_MAX_CELLS = 6000
_BUILDING, _TREE = 0.45, 0.35  # shares of the cells
_CLEAR = 4.5  # m between a lane's center and what stands beside it
_TREE_PARTS = [
    SolidPart((-0.06, -0.06, 0.0), (0.06, 0.06, 0.45), Material.TRUNK),
    SolidPart((-0.5, -0.5, 0.35), (0.5, 0.5, 0.75), Material.LEAVES, taper=(-0.02, -0.02, -0.02)),
    SolidPart((-0.42, -0.42, 0.75), (0.42, 0.42, 1.0), Material.LEAVES, taper=(0.22, 0.22, 0.22)),
]


def surrounding_solids(log: Log, seed: int) -> Solids:
    """Buildings and trees around the lanes of a log, on level ground at z = 0."""
    lines = [lane.points[:, :2] for lane in log.lanes if len(lane.points) > 1]
    if not lines:
        return no_solids()
    from scipy.spatial import KDTree

    points, _ = spread_lines(lines, 2.0)
    low, high = np.floor((points.min(0) - _AROUND) / _CELL), np.ceil((points.max(0) + _AROUND) / _CELL)
    columns, rows = (np.arange(a, b) for a, b in zip(low, high, strict=True))
    tree = KDTree(points)
    cells = np.stack(np.meshgrid(columns, rows, indexing="ij"), -1).reshape(-1, 2)
    distance, _ = tree.query((cells + 0.5) * _CELL)
    cells = cells[(distance < _AROUND) & (distance > _CLEAR)]
    if len(cells) > _MAX_CELLS:
        cells = cells[:: len(cells) // _MAX_CELLS + 1]
    draws = hashed_numbers(cells, seed)
    centers = (cells + 0.5) * _CELL + 4.0 * (draws[:, :2] - 0.5)
    distance, _ = tree.query(centers)
    headings = np.round(draws[:, 2] * 2) * 0.08
    building = (draws[:, 3] < _BUILDING) & (distance > _CLEAR + 5.5)
    sizes = np.stack([6 + 6 * draws[:, 4], 6 + 6 * draws[:, 5], 4 + 24 * draws[:, 6] ** 2], -1)
    reach = np.hypot(sizes[:, 0], sizes[:, 1]) / 2 + _CLEAR
    sizes[:, :2] *= np.minimum(1.0, distance / reach)[:, None]
    trees = (draws[:, 3] >= _BUILDING) & (draws[:, 3] < _BUILDING + _TREE) & (distance > _CLEAR + 1.5)
    return join_solids(
        [
            _buildings(centers[building], headings[building], sizes[building], draws[building]),
            _trees(centers[trees], draws[trees]),
        ]
    )


def _buildings(centers: np.ndarray, headings: np.ndarray, sizes: np.ndarray, draws: np.ndarray) -> Solids:
    count = len(centers)
    corners = box_corners_3d(np.column_stack([centers, sizes[:, 2] / 2]), headings, sizes)
    walls = WALLS[(draws[:, 7] * len(WALLS)).astype(int)] * (0.8 + 0.4 * draws[:, 6:7])
    colors = np.repeat(walls[:, None], 6, 1)
    colors[:, TOP] *= 0.7
    materials = np.full((count, 6), Material.WALL)
    materials[:, TOP] = Material.ROOF
    return Solids(corners, colors, materials, np.full(count, SemanticClass.BUILDING), np.full(count, -1))


def _trees(centers: np.ndarray, draws: np.ndarray) -> Solids:
    count, parts = len(centers), len(_TREE_PARTS)
    height = 4 + 5 * draws[:, 4]
    width = 2.4 + 2.0 * draws[:, 5]
    sizes = np.stack([width, width, height], -1)
    places = np.column_stack([centers, np.zeros(count)])
    corners = place_parts(part_corners(_TREE_PARTS), places, 3.1 * draws[:, 6], sizes).reshape(-1, 8, 3)
    materials = np.tile(part_materials(_TREE_PARTS), (count, 1))
    leaves = LEAVES[(draws[:, 7] * len(LEAVES)).astype(int)]
    colors = np.where(
        (materials == Material.LEAVES)[..., None], np.repeat(leaves, parts, 0)[:, None], COLORS[materials]
    )
    total = count * parts
    return Solids(corners, colors, materials, np.full(total, SemanticClass.VEGETATION), np.full(total, -1))


def hashed_numbers(cells: Real[np.ndarray, "n 2"], seed: int) -> Float64[np.ndarray, "n 8"]:
    """Eight numbers in 0..1 for each pair of whole numbers, such as the place of a cell, by hashing it and the seed."""
    values = np.empty((len(cells), 8))
    x, y = (cells[:, axis].astype(np.int64).astype(np.uint64) for axis in (0, 1))
    for column in range(8):
        start = (seed * 1_000_003 + column * 7_919 + 1) & (2**64 - 1)
        state = x * np.uint64(0x9E3779B97F4A7C15) ^ y * np.uint64(0xC2B2AE3D27D4EB4F) ^ np.uint64(start)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB), (31, 1)):
            state = (state ^ (state >> np.uint64(shift))) * np.uint64(factor)
        values[:, column] = (state >> np.uint64(11)).astype(np.float64) / 2**53
    return values
