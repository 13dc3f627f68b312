"""Wireframes: lanes, borders, signals and boxes of a log as lines in the picture of a camera."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from scjax.camera.agent_boxes import EDGES, FACES, FRONT, FRONT_CROSS, REAR_EDGES, visible_edges, visible_faces
from scjax.camera.camera import Camera
from scjax.camera.frame_buffers import BufferElements, buffers_of
from scjax.camera.palettes import PALETTES
from scjax.camera.projected_elements import ProjectedBoxes, ProjectedLines
from scjax.camera.projection import FAR, NEAR, project_faces, project_segments
from scjax.camera.raster import convex_hull, darken, draw_segments
from scjax.camera.wireframe_scene import ElementKind, WireframeScene, WorldBoxes, WorldLines
from scjax.scene.arguments import finite_number, listed_choice, truth_value, whole_number

_ROWS_PER_PIXEL = 400  # rows of a picture for each pixel of the width of its lines
_LINES = np.concatenate([EDGES, FRONT_CROSS])  # of a box
_BOX_OPACITY, _HIDDEN = 0.85, 0.35


@dataclasses.dataclass(frozen=True, kw_only=True)
class WireframeStyle:
    """How a wireframe looks.

    Attributes:
      palette: name of the colors: scjax, cosmos or sc.
      occlusion: boxes cover what is behind them, and their edges on the far side are dim. False: all lines show.
      depth_cue: share of the brightness that is lost at the far plane.
      near, far: depths between which lines are drawn [m].
      borders: show borders of the road.
      width: of lines [pixels]; by default 1 for each 400 rows.
      snap_to_ground: put boxes that float or sink by less than 0.6 m on the ground.

    Raises:
      ValueError: naming the field that is out of range.
    """

    palette: str = "scjax"
    occlusion: bool = True
    depth_cue: float = 0.6
    near: float = NEAR
    far: float = FAR
    borders: bool = True
    width: int | None = None
    snap_to_ground: bool = False

    def __post_init__(self):
        listed_choice(self.palette, "palette", PALETTES)
        for name in ("occlusion", "borders", "snap_to_ground"):
            truth_value(getattr(self, name), name)
        finite_number(self.depth_cue, "depth_cue", 0.0, 1.0)
        finite_number(self.near, "near", 1e-3, 100.0)
        finite_number(self.far, "far", self.near, 1e5)
        if self.width is not None:
            whole_number(self.width, "width", 1, 100)


class WireframeFrame(NamedTuple):
    """A picture and what its pixels belong to; depth, ids and kinds are None where they were not requested.

    Attributes:
      rgb: the picture.
      num_lines: that were drawn.
      depth: along the axis of the camera [m], inf where nothing is.
      ids: index of the object, lane or signal; -1 where nothing is.
      kinds: ``ElementKind``.
    """

    rgb: UInt8[np.ndarray, "height width 3"]
    num_lines: int
    depth: Float32[np.ndarray, "height width"] | None = None
    ids: Int32[np.ndarray, "height width"] | None = None
    kinds: UInt8[np.ndarray, "height width"] | None = None


def draw_wireframe(
    scene: WireframeScene,
    step: int,
    camera: Camera,
    rotation: Float64[np.ndarray, "3 3"],
    position: Float64[np.ndarray, " 3"],
    style: WireframeStyle,
    *,
    background: UInt8[np.ndarray, "height width 3"] | None = None,
    buffers: bool = False,
) -> WireframeFrame:
    """The wireframe of one step from a camera with the axes ``rotation`` (columns) at ``position``.

    Args:
      background: picture to draw on, of the size of the camera; black by default.
      buffers: make ``depth``, ``ids`` and ``kinds`` too.
    """
    unit = style.width or max(1, round(camera.height / _ROWS_PER_PIXEL))
    world_lines, world_boxes = scene.lines(step, position, style.far), scene.boxes(step, position, style.far)
    lines = project_lines(camera, rotation, position, world_lines, style, unit)
    boxes = project_boxes(camera, rotation, position, world_boxes, style, unit)
    image = np.zeros((camera.height, camera.width, 3 if background is None else 4), np.uint8)
    _draw(image, lines, slice(None))
    for k in range(len(boxes.owners)):
        if style.occlusion:
            outline = boxes.faces[boxes.face_boxes == k].reshape(-1, 2)
            if len(outline):
                darken(image, convex_hull(outline), _BOX_OPACITY)
        _draw(image, boxes.lines, slice(boxes.starts[k], boxes.starts[k + 1]))
    rgb = image if background is None else _over(image, background)
    count = len(lines.ends) + len(boxes.lines.ends)
    if not buffers:
        return WireframeFrame(rgb, count)
    elements = BufferElements(lines, boxes, world_lines, world_boxes)
    return WireframeFrame(rgb, count, *buffers_of(camera, elements, fills_faces=style.occlusion))


def project_lines(
    camera: Camera, rotation: np.ndarray, position: np.ndarray, world: WorldLines, style: WireframeStyle, unit: int
) -> ProjectedLines:
    """Lines on the road: borders, lanes, then stop lines, each from far to near."""
    first, second = ((ends - position) @ rotation for ends in (world.first, world.second))
    parts = project_segments(camera, first, second, near=style.near, far=style.far)
    kinds = world.kinds[parts.rows]
    layer = np.select([kinds == ElementKind.BORDER, kinds == ElementKind.LANE], [0, 1], 2)
    order = np.lexsort([parts.inverse_depths.min(1), layer])
    rows, inverse = parts.rows[order], parts.inverse_depths[order]
    is_far = inverse.min(1) < 2 / style.far
    widths = np.where(is_far, max(unit - 1, 1), unit) + (world.kinds[rows] == ElementKind.STOP_LINE)
    colors = _shaded(world.colors[rows], inverse, style)
    return ProjectedLines(parts.ends[order], inverse, colors, widths, rows)


def project_boxes(
    camera: Camera, rotation: np.ndarray, position: np.ndarray, world: WorldBoxes, style: WireframeStyle, unit: int
) -> ProjectedBoxes:
    """Boxes that reach between the near and the far plane."""
    corners = (world.corners - position) @ rotation
    depths = corners[..., 2]
    chosen = np.flatnonzero(
        (depths.max(-1, initial=-np.inf) > style.near) & (depths.min(-1, initial=np.inf) < style.far)
    )
    chosen = chosen[np.argsort(-depths[chosen].max(-1, initial=-np.inf), kind="stable")]
    corners = corners[chosen]
    facing = visible_faces(corners)
    shown = np.concatenate([visible_edges(facing), facing[:, [FRONT, FRONT]]], 1)
    ends = corners[:, _LINES]
    parts = project_segments(
        camera, ends[:, :, 0].reshape(-1, 3), ends[:, :, 1].reshape(-1, 3), near=style.near, far=style.far
    )
    box, line = np.divmod(parts.rows, len(_LINES))
    is_agent = world.kinds[chosen] == ElementKind.BOX
    keep = (line < len(EDGES)) | is_agent[box]
    ends, inverse, box, line = parts.ends[keep], parts.inverse_depths[keep], box[keep], line[keep]
    front = shown[box, line] | (not style.occlusion)
    order = np.lexsort([front, box])  # hidden lines first
    ends, inverse, box, line, front = ends[order], inverse[order], box[order], line[order], front[order]
    colors = _shaded(world.colors[chosen][box], inverse, style, np.where(front, 1.0, _HIDDEN))
    rear = np.concatenate([REAR_EDGES, np.zeros(len(FRONT_CROSS), bool)])[line] & is_agent[box]
    thin = (line >= len(EDGES)) | ~front
    near_unit = np.where(inverse.min(1) < 2 / style.far, max(unit - 1, 1), unit)
    widths = np.where(thin, 1, near_unit + rear)
    lines = ProjectedLines(ends, inverse, colors, widths, chosen[box])
    owner, face = np.nonzero(facing)
    face_corners = corners[:, FACES][owner, face]
    faces = project_faces(camera, face_corners, style.near)
    seen = np.isfinite(faces).all((1, 2))
    starts = np.searchsorted(box, np.arange(len(chosen) + 1))
    return ProjectedBoxes(lines, chosen, starts, front, faces[seen], face_corners[seen], owner[seen])


def _shaded(colors: np.ndarray, inverse_depths: np.ndarray, style: WireframeStyle, factor: np.ndarray | float = 1.0):
    """Colors that are darker the farther away the middle of a line is."""
    depth = 2 / np.maximum(inverse_depths.sum(1), 1e-9)
    factor = factor * (1 - style.depth_cue * (depth / style.far).clip(0, 1))
    return np.round(colors * np.reshape(factor, (-1, 1))).astype(np.uint8)


def _draw(image: np.ndarray, lines: ProjectedLines, part: slice) -> None:
    colors = lines.colors[part]
    if image.shape[2] == 4:
        colors = np.concatenate([colors, np.full((len(colors), 1), 255, np.uint8)], 1)
    draw_segments(image, lines.ends[part], colors, lines.widths[part])


def _over(drawn: np.ndarray, background: np.ndarray) -> np.ndarray:
    """A drawing whose colors are multiplied by its opacity, on a picture."""
    share = 255 - drawn[..., 3:].astype(np.uint16)
    return (drawn[..., :3] + (background * share + 127) // 255).clip(0, 255).astype(np.uint8)
