"""Depth, ids and kinds of the pixels of a wireframe."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from scjax.camera.camera import Camera
from scjax.camera.projection import pixel_rays
from scjax.camera.raster import draw_indices, fill_index
from scjax.camera.wireframe_scene import ElementKind, WorldBoxes, WorldLines

if TYPE_CHECKING:
    from scjax.camera.wireframe import ProjectedBoxes, ProjectedLines


class BufferElements(NamedTuple):
    """All that is drawn, in the picture and in the world."""

    lines: ProjectedLines
    boxes: ProjectedBoxes
    world_lines: WorldLines
    world_boxes: WorldBoxes


class FrameBuffers(NamedTuple):
    """As in ``WireframeFrame``."""

    depth: Float32[np.ndarray, "height width"]
    ids: Int32[np.ndarray, "height width"]
    kinds: UInt8[np.ndarray, "height width"]


def buffers_of(camera: Camera, elements: BufferElements, *, fills_faces: bool) -> FrameBuffers:
    """The buffers of a picture.

    Every pixel keeps the number of what was drawn over it last, in the order of the picture. From it follow the depth on
    the line or face at that pixel, its id and its kind.

    Args:
      fills_faces: faces of boxes cover what is behind them.
    """
    lines, boxes = elements.lines, elements.boxes
    ends = np.concatenate([lines.ends, boxes.lines.ends])
    inverse = np.concatenate([lines.inverse_depths, boxes.lines.inverse_depths])
    count, base = len(lines.ends), len(ends)
    numbers = np.full((camera.height, camera.width), -1, np.int32)
    draw_indices(numbers, lines.ends, np.arange(count), lines.widths)
    for k in range(len(boxes.owners)):
        if fills_faces:
            for face in np.flatnonzero(boxes.face_boxes == k).tolist():
                fill_index(numbers, boxes.faces[face], base + face)
        part = slice(boxes.starts[k], boxes.starts[k + 1])
        draw_indices(numbers, boxes.lines.ends[part], count + np.arange(part.start, part.stop), boxes.lines.widths[part])
    face_owners = boxes.owners[boxes.face_boxes]
    world_lines, world_boxes = elements.world_lines, elements.world_boxes
    owners = np.concatenate([boxes.lines.owners, face_owners])
    ids = np.concatenate([world_lines.ids[lines.owners], world_boxes.ids[owners], [-1]])
    kinds = np.concatenate([world_lines.kinds[lines.owners], world_boxes.kinds[owners], [ElementKind.NOTHING]])
    depth = np.full(numbers.shape, np.inf, np.float32)
    rows, columns = np.nonzero(numbers >= 0)
    number = numbers[rows, columns]
    pixels = np.stack([columns, rows], -1).astype(np.float64)
    values = np.empty(len(number))
    on_line = number < base
    values[on_line] = _line_depths(pixels[on_line], ends[number[on_line]], inverse[number[on_line]])
    rays = pixel_rays(camera, pixels[~on_line])
    values[~on_line] = _face_depths(rays, boxes.face_corners[number[~on_line] - base])
    depth[rows, columns] = values
    return FrameBuffers(depth, ids.astype(np.int32)[numbers], kinds.astype(np.uint8)[numbers])


def _line_depths(pixels: np.ndarray, ends: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Depths on lines at the points that are nearest to pixels."""
    along = ends[:, 1] - ends[:, 0]
    square = np.maximum((along * along).sum(-1), 1e-12)
    share = (((pixels - ends[:, 0]) * along).sum(-1) / square).clip(0, 1)
    return 1 / (inverse[:, 0] + share * (inverse[:, 1] - inverse[:, 0]))


def _face_depths(rays: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Depths at which rays meet the planes of faces, kept between the depths of their corners."""
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    distance = (normals * corners[:, 0]).sum(-1)
    slope = (normals[:, :2] * rays).sum(-1) + normals[:, 2]
    depth = distance / np.where(np.abs(slope) < 1e-12, 1e-12, slope)
    low, high = corners[:, :, 2].min(-1), corners[:, :, 2].max(-1)
    return np.where(np.isfinite(depth), depth, high).clip(np.maximum(low, 1e-3), high)
