"""What the cells of a rendered picture show, in numbers from which a vision encoder learns."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float16, Float64, Int, UInt8

from scjax.camera.dashcam.materials import SemanticClass
from scjax.camera.dashcam.renderer import DashcamFrame
from scjax.scene import Scene

MAX_DEPTH = 100.0
"""Depths beyond this are this [m]."""

_LEAST_SHARE = 0.1  # of a cell's pixels that an object covers at least
_BESIDE = 4.0  # m between a place on the road and the lane that it is of
_ROAD = (SemanticClass.ROAD, SemanticClass.MARKING)


class CellTargets(NamedTuple):
    """Targets of the cells of a picture; places are in the frame of the carrier: x ahead, y to the left [m].

    Attributes:
      classes: share of each ``SemanticClass`` among the pixels, 255 for all.
      depth: harmonic mean of the depths [m].
      objects: x, y, cosine and sine of the heading, length, width of the object that covers most, and 1; or zeros.
      lanes: x, y of the point of a lane next to the cell's road, cosine and sine of its direction, the distance from
        that lane to the left of it [m], and 1; or zeros.
    """

    classes: UInt8[np.ndarray, "rows columns classes"]
    depth: Float16[np.ndarray, "rows columns"]
    objects: Float16[np.ndarray, "rows columns 7"]
    lanes: Float16[np.ndarray, "rows columns 6"]


def cell_targets(
    frame: DashcamFrame,
    rays: Float64[np.ndarray, "height width 2"],
    mount: tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, " 3"]],
    boxes: Float64[np.ndarray, "objects 6"],
    scene: Scene,
    cells: tuple[int, int],
) -> CellTargets:
    """The targets of a picture.

    Args:
      rays: x and y at depth 1 of what the pixels see.
      mount: rotation and position of the camera in the frame of the carrier; z is above the ground.
      boxes: x, y, cosine and sine of the heading, length, width of all objects of the log, by ``frame.ids``.
      scene: its lanes, in the frame of the carrier.
      cells: rows and columns; they divide the picture.
    """
    height, width = frame.depth.shape
    grid = _CellGrid(height, width, *cells)
    shares = grid.counts(frame.classes, len(SemanticClass)) / grid.area
    inverse = 1 / np.clip(frame.depth, 1.0, MAX_DEPTH)
    inverse = inverse.reshape(grid.rows, -1, grid.columns, grid.width // grid.columns).mean((1, 3))
    return CellTargets(
        np.round(255 * shares).astype(np.uint8).reshape(*cells, -1),
        (1 / inverse).astype(np.float16),
        _objects(frame.ids, grid, boxes).astype(np.float16).reshape(*cells, 7),
        _lanes(*_road_middles(frame, rays, mount, grid), scene, grid.area).astype(np.float16).reshape(*cells, 6),
    )


class _CellGrid(NamedTuple):
    """Pixels and cells of a picture."""

    height: int
    width: int
    rows: int
    columns: int

    @property
    def area(self) -> int:
        """Pixels of a cell."""
        return self.height * self.width // (self.rows * self.columns)

    @property
    def size(self) -> int:
        """Number of cells."""
        return self.rows * self.columns

    def counts(self, numbers: np.ndarray, kinds: int) -> Int[np.ndarray, "cells kinds"]:
        """How many pixels of each cell have each of these numbers [height, width]; others are not counted."""
        shown = np.flatnonzero((numbers >= 0) & (numbers < kinds))
        both = _cell_of_pixels(self)[shown] * kinds + numbers.ravel()[shown]
        return np.bincount(both, minlength=self.size * kinds).reshape(self.size, kinds)


@functools.lru_cache(maxsize=4)
def _cell_of_pixels(grid: _CellGrid) -> Int[np.ndarray, " pixels"]:
    """Number of the cell of each pixel, both row by row."""
    row, column = (
        np.arange(count) // (count // parts) for count, parts in ((grid.height, grid.rows), (grid.width, grid.columns))
    )
    return (row[:, None] * grid.columns + column).ravel()


def _objects(ids: np.ndarray, grid: _CellGrid, boxes: np.ndarray) -> np.ndarray:
    """Targets of the object that covers most pixels of each cell [cells, 7]."""
    result = np.zeros((grid.size, 7))
    present = np.flatnonzero(np.bincount(ids[ids >= 0], minlength=len(boxes)))
    if len(present):
        numbers = np.full(len(boxes) + 1, -1)  # the last is that of pixels without an object
        numbers[present] = np.arange(len(present))
        covered = grid.counts(numbers[ids], len(present))
        shown = np.flatnonzero(covered.max(1) >= _LEAST_SHARE * grid.area)
        result[shown, :6], result[shown, 6] = boxes[present[covered[shown].argmax(1)]], 1
    return result


def _road_middles(
    frame: DashcamFrame, rays: np.ndarray, mount: tuple[np.ndarray, np.ndarray], grid: _CellGrid
) -> tuple[np.ndarray, np.ndarray]:
    """Number of pixels of each cell that show the road, and the middle of what they show [cells, 2]."""
    rotation, position = mount
    pixels = np.flatnonzero(np.isin(frame.classes, _ROAD) & np.isfinite(frame.depth))
    x, y = rays.reshape(-1, 2)[pixels].T
    depth, cell = frame.depth.ravel()[pixels], _cell_of_pixels(grid)[pixels]
    counts = np.bincount(cell, minlength=grid.size)
    places = [
        (row[0] * x + row[1] * y + row[2]) * depth + start
        for row, start in zip(rotation[:2], position[:2], strict=True)
    ]
    sums = [np.bincount(cell, weights=place, minlength=grid.size) for place in places]
    return counts, np.stack(sums, -1) / np.maximum(counts, 1)[:, None]


def _lanes(counts: np.ndarray, middles: np.ndarray, scene: Scene, area: int) -> np.ndarray:
    """Targets of the lane beside the middle of each cell's road [cells, 6]."""
    result = np.zeros((len(counts), 6))
    shown = np.flatnonzero(counts >= _LEAST_SHARE * area)
    middles = middles[shown]
    lanes = np.asarray(scene.lanes, np.float64)[np.asarray(scene.lane_mask), :, :2]
    if not len(lanes) or not len(shown):
        return result
    starts, ends = lanes[:, :-1].reshape(-1, 2), lanes[:, 1:].reshape(-1, 2)
    reached = (np.maximum(starts, ends) > middles.min(0) - _BESIDE) & (
        np.minimum(starts, ends) < middles.max(0) + _BESIDE
    )
    starts, steps = starts[reached.all(1)], (ends - starts)[reached.all(1)]
    if not len(starts):
        return result
    lengths = np.maximum(np.hypot(*steps.T), 1e-6)
    # x and y apart: arrays whose last axis has two entries take several times as long.
    x, y = (middles[:, None, axis] - starts[None, :, axis] for axis in (0, 1))
    along = ((x * steps[:, 0] + y * steps[:, 1]) / lengths**2).clip(0, 1)
    squares = (x - along * steps[:, 0]) ** 2 + (y - along * steps[:, 1]) ** 2
    best = squares.argmin(1)
    point = starts[best] + along[np.arange(len(shown)), best, None] * steps[best]
    direction = steps[best] / lengths[best, None]
    side = middles - point
    left = direction[:, 0] * side[:, 1] - direction[:, 1] * side[:, 0]
    near = squares.min(1) < _BESIDE**2
    result[shown[near]] = np.column_stack([point, direction, left, np.ones(len(shown))])[near]
    return result
