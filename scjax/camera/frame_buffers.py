"""Depth, ids and kinds of the pixels of a wireframe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from scjax.camera.agent_boxes import face_normals
from scjax.camera.camera import Camera
from scjax.camera.projected_elements import ProjectedBoxes, ProjectedLines
from scjax.camera.projection import pixel_rays
from scjax.camera.raster import draw_indices, fill_index
from scjax.camera.wireframe_scene import ElementKind, WorldBoxes, WorldLines


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

    Every pixel keeps the number of what was drawn over it last, in the order of the picture. From it follow the depth
    on the line or face at that pixel, its id and its kind.

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
        part = np.arange(boxes.starts[k], boxes.starts[k + 1])
        part = part[boxes.in_front[part]]  # the others are behind faces
        draw_indices(numbers, boxes.lines.ends[part], count + part, boxes.lines.widths[part])
    face_owners = boxes.owners[boxes.face_boxes]
    world_lines, world_boxes = elements.world_lines, elements.world_boxes
    owners = np.concatenate([boxes.lines.owners, face_owners])
    ids = np.concatenate([world_lines.ids[lines.owners], world_boxes.ids[owners], [-1]])
    kinds = np.concatenate([world_lines.kinds[lines.owners], world_boxes.kinds[owners], [ElementKind.NOTHING]])
    inverse_depth = np.zeros(numbers.size)
    flat = numbers.ravel()
    on_line = np.flatnonzero((flat >= 0) & (flat < base))
    inverse_depth[on_line] = _on_lines(_pixels_at(on_line, camera.width), flat[on_line], ends, inverse)
    on_face = np.flatnonzero(flat >= base)
    rays = pixel_rays(camera, _pixels_at(on_face, camera.width))
    inverse_depth[on_face] = _on_faces(rays, flat[on_face] - base, boxes.face_corners)
    with np.errstate(divide="ignore"):
        depth = (1 / inverse_depth).astype(np.float32).reshape(numbers.shape)
    return FrameBuffers(depth, ids.astype(np.int32)[numbers], kinds.astype(np.uint8)[numbers])


def _pixels_at(flat: np.ndarray, width: int) -> np.ndarray:
    """Column and row of pixels that are counted row by row [n, 2]."""
    rows, columns = np.divmod(flat, width)
    return np.stack([columns, rows], -1).astype(np.float64)


def _on_lines(pixels: np.ndarray, lines: np.ndarray, ends: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Inverse depths on lines at the points that are nearest to pixels; ``lines`` is the index of the line of each."""
    along = ends[:, 1] - ends[:, 0]
    rate = along / np.maximum((along * along).sum(-1, keepdims=True), 1e-12)
    start = (ends[:, 0] * rate).sum(-1)
    share = ((pixels * rate[lines]).sum(-1) - start[lines]).clip(0, 1)
    return inverse[lines, 0] + share * (inverse[:, 1] - inverse[:, 0])[lines]


def _on_faces(rays: np.ndarray, faces: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Inverse depths where rays meet the planes of faces, kept between those of their corners."""
    normals = face_normals(corners)
    distance = (normals * corners[:, 0]).sum(-1, keepdims=True)
    planes = normals / np.where(np.abs(distance) < 1e-12, 1e-12, distance)  # a visible face has a distance
    depths = corners[:, :, 2].clip(1e-3, None)
    low, high = 1 / depths.max(-1), 1 / depths.min(-1)
    plane = planes[faces]
    inverse = plane[:, 0] * rays[:, 0] + plane[:, 1] * rays[:, 1] + plane[:, 2]
    return np.where(np.isfinite(inverse), inverse, low[faces]).clip(low[faces], high[faces])
