"""What the cells of a rendered picture show, in numbers from which a vision encoder learns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float16, Float64, UInt8

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
    rows, columns = cells
    shape = (rows, frame.rgb.shape[0] // rows, columns, frame.rgb.shape[1] // columns)

    def by_cell(values: np.ndarray) -> np.ndarray:
        return values.reshape(*shape, -1).swapaxes(1, 2).reshape(rows * columns, shape[1] * shape[3], -1)

    one_hot = by_cell(frame.classes) == np.arange(len(SemanticClass))
    inverse = 1 / np.clip(by_cell(frame.depth)[..., 0], 1.0, MAX_DEPTH)
    return CellTargets(
        np.round(255 * one_hot.mean(1)).astype(np.uint8).reshape(rows, columns, -1),
        (1 / inverse.mean(1)).astype(np.float16).reshape(cells),
        _objects(by_cell(frame.ids)[..., 0], boxes).astype(np.float16).reshape(rows, columns, 7),
        _lanes(by_cell(_ground_places(frame, rays, mount)), scene).astype(np.float16).reshape(rows, columns, 6),
    )


def _objects(ids: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Targets of the object that covers most pixels of each cell [cells, 7]."""
    result = np.zeros((len(ids), 7))
    found, counts = np.full(len(ids), -1), np.zeros(len(ids))
    for object_id in np.unique(ids[ids >= 0]).tolist():
        covered = (ids == object_id).sum(1)
        found = np.where(covered > counts, object_id, found)
        counts = np.maximum(counts, covered)
    shown = counts >= _LEAST_SHARE * ids.shape[1]
    result[shown, :6], result[shown, 6] = boxes[found[shown]], 1
    return result


def _ground_places(frame: DashcamFrame, flat: np.ndarray, mount: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """x and y of what pixels of the road show [height, width, 2]; NaN elsewhere."""
    rays = np.concatenate([flat, np.ones((*flat.shape[:2], 1))], -1)
    rotation, position = mount
    depth = np.where(np.isfinite(frame.depth), frame.depth, np.nan)[..., None]
    places = (rays * depth) @ rotation[:2].T + position[:2]
    return np.where(np.isin(frame.classes, _ROAD)[..., None], places, np.nan)


def _lanes(places: np.ndarray, scene: Scene) -> np.ndarray:
    """Targets of the lane beside the middle of each cell's road [cells, 6]."""
    result = np.zeros((len(places), 6))
    counts = np.isfinite(places[..., 0]).sum(1)
    shown = np.flatnonzero(counts >= _LEAST_SHARE * places.shape[1])
    middles = np.nansum(places[shown], 1) / counts[shown, None]
    lanes = np.asarray(scene.lanes, np.float64)[np.asarray(scene.lane_mask), :, :2]
    if not len(lanes) or not len(shown):
        return result
    starts, steps = lanes[:, :-1].reshape(-1, 2), (lanes[:, 1:] - lanes[:, :-1]).reshape(-1, 2)
    lengths = np.maximum(np.hypot(*steps.T), 1e-6)
    # x and y apart: arrays whose last axis has two entries take several times as long.
    x, y = (middles[:, None, axis] - starts[None, :, axis] for axis in (0, 1))
    along = ((x * steps[:, 0] + y * steps[:, 1]) / lengths**2).clip(0, 1)
    distances = np.hypot(x - along * steps[:, 0], y - along * steps[:, 1])
    best = distances.argmin(1)
    point = starts[best] + along[np.arange(len(shown)), best, None] * steps[best]
    direction = steps[best] / lengths[best, None]
    side = middles - point
    left = direction[:, 0] * side[:, 1] - direction[:, 1] * side[:, 0]
    near = distances.min(1) < _BESIDE
    result[shown[near]] = np.column_stack([point, direction, left, np.ones(len(shown))])[near]
    return result
