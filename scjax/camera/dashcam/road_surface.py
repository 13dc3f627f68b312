"""The ground around a camera: terrain, sidewalks, roads and markings, drawn from above and seen in perspective."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from scjax.camera.camera import Camera
from scjax.camera.dashcam.look import Look
from scjax.camera.dashcam.materials import SemanticClass
from scjax.camera.dashcam.zbuffer import plane_values
from scjax.camera.raster import require_opencv
from scjax.camera.road_lines import LANE_WIDTH, OTHER_WAY, OUTSIDE, SAME_WAY, LaneSide, lane_sides
from scjax.scene import Log
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.scene.polyline import cumulative_length
from scjax.scene.stop_lines import stop_lines

_DASH, _GAP = 3.0, 6.0  # m
_CLOSE = 0.02  # m
_LINE_WIDTH, _STOP_WIDTH, _SIDEWALK = 0.14, 0.45, 2.0  # m
_YELLOW = (0.85, 0.65, 0.15)
_GRAIN, _GRAIN_CELLS = 0.08, 256  # standard deviation of the brightness of a cell; cells after which it repeats
_SHIFT, _UNIT = 4, 16.0
_LEAST = 1e-4  # 1/m; ground farther away is sky


class GroundLayer(NamedTuple):
    """A square window of the ground around a place ahead of the camera.

    Attributes:
      side, cell: of the window and of its cells [m].
      reach: how far from the camera it is seen [m].
      slack: how far its middle may be from that place [m].
      ahead: distance of the place from the camera [m].
    """

    side: float
    cell: float
    reach: float
    slack: float
    ahead: float = 0.0


_NEAR = GroundLayer(64.0, 0.0625, 24.0, 8.0)
_NEAR_SLACK = 4.0  # m; of windows that show what is ahead alone
_FAR, _COARSE = GroundLayer(320.0, 0.25, 130.0, 30.0), GroundLayer(320.0, 0.5, 130.0, 30.0)
_SMALL_FOCAL = 400.0  # pixels; cameras with less see no details of the far ground

_TERRAIN, _WALK, _ROAD, _WHITE, _YELLOW_LINE, _STOP_LINE = range(6)
_CLASSES = np.zeros(256, np.uint8)
_CLASSES[:6] = (
    *(SemanticClass.TERRAIN, SemanticClass.SIDEWALK, SemanticClass.ROAD),
    *(SemanticClass.MARKING, SemanticClass.MARKING, SemanticClass.MARKING),
)


class GroundView(NamedTuple):
    """The ground in a picture.

    Attributes:
      colors: without light.
      classes: ``SemanticClass``; SKY above the horizon.
      inverse_depth: 0 above the horizon [1/m].
    """

    colors: UInt8[np.ndarray, "height width 3"]
    classes: UInt8[np.ndarray, "height width"]
    inverse_depth: Float32[np.ndarray, "height width"]


@dataclasses.dataclass(frozen=True)
class _Drawn:
    """A drawn layer: place of its middle, colors and codes."""

    middle: np.ndarray
    colors: np.ndarray
    codes: np.ndarray


@dataclasses.dataclass(frozen=True)
class _Lines:
    """Polylines of the road [n, 2] m with boxes around them, and markings as segments."""

    polylines: list[np.ndarray]
    low: np.ndarray
    high: np.ndarray
    white: np.ndarray
    yellow: np.ndarray
    stop: np.ndarray


class RoadSurface:
    """Draws the ground of a log around a camera. The ground is level; heights of lanes do not matter.

    Windows are aligned with the map and kept until the camera leaves their middle.

    Args:
      log: whose lanes are roads.
      look: of the picture.
    """

    def __init__(self, log: Log, look: Look):
        self._lines, self._look = _lines_of(log), look
        self._drawn: dict[GroundLayer, _Drawn] = {}

    def view(
        self, camera: Camera, rotation: Float64[np.ndarray, "3 3"], position: Float64[np.ndarray, " 3"]
    ) -> GroundView:
        """The ground in a picture.

        Args:
          rotation, position: of a pinhole camera in the frame of the log, its z above the ground.
        """
        cv2 = require_opencv()
        inverse = np.linalg.inv(camera.intrinsic)
        plane = (rotation[2] / -position[2]) @ inverse  # inverse depth of the ground of (column, row, 1)
        width, height = camera.width, camera.height
        depth = plane_values(plane, width, height)
        below = depth > _LEAST
        smooth, exact = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        colors, codes = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.uint8)
        ahead = rotation[:2, 2] / max(float(np.hypot(*rotation[:2, 2])), 1e-6)
        near, far = _near_layer(camera), _COARSE if camera.intrinsic[0, 0] < _SMALL_FOCAL else _FAR
        for layer in (far, near):
            # Only the rows in which some ground is within reach.
            least = 1 / layer.reach if layer is near else _LEAST
            within = np.flatnonzero(np.maximum(depth[:, 0], depth[:, -1]) > np.float32(least))
            if not len(within):
                continue
            top, bottom = int(within[0]), int(within[-1]) + 1
            drawn = self._layer(layer, position[:2] + layer.ahead * ahead)
            # (column, row, 1) of the picture -> (column, row, 1) of the layer, times inverse depth.
            offset = position[:2] - drawn.middle
            ground = rotation[:2] @ inverse + offset[:, None] * plane
            half = layer.side / 2
            matrix = np.stack([ground[0] + half * plane, half * plane - ground[1], layer.cell * plane]) / layer.cell
            matrix[:2] -= 0.5 * plane
            matrix[:, 2] += top * matrix[:, 1]
            size = (width, bottom - top)
            some_colors = cv2.warpPerspective(drawn.colors, matrix, size, flags=smooth)
            some_codes = cv2.warpPerspective(drawn.codes, matrix, size, flags=exact)
            if layer is far:
                colors[top:bottom], codes[top:bottom] = some_colors, some_codes
                continue
            # Within reach along the axis of the camera, and inside the window to both sides.
            ground[:, 2] += top * ground[:, 1]
            east, north = (np.abs(plane_values(row, *size)) for row in ground)
            some_depth = depth[top:bottom]
            inside = (np.maximum(east, north) < np.float32(half - 1) * some_depth) & (some_depth > np.float32(least))
            mask = inside.view(np.uint8)
            cv2.copyTo(some_colors, mask, colors[top:bottom])
            cv2.copyTo(some_codes, mask, codes[top:bottom])
        classes = cv2.LUT(codes, _CLASSES)
        classes[~below] = SemanticClass.SKY
        return GroundView(colors, classes, np.where(below, depth, np.float32(0)))

    def _layer(self, layer: GroundLayer, place: np.ndarray) -> _Drawn:
        """The window around a place."""
        drawn = self._drawn.get(layer)
        if drawn is None or np.abs(place - drawn.middle).max() > layer.slack:
            drawn = self._drawn[layer] = self._draw(layer, np.floor(place / layer.cell) * layer.cell)
        return drawn

    def _draw(self, layer: GroundLayer, middle: np.ndarray) -> _Drawn:
        cv2 = require_opencv()
        look, lines, half = self._look, self._lines, layer.side / 2
        count = round(layer.side / layer.cell)
        codes = np.full((count, count), _TERRAIN, np.uint8)

        def fixed(points: np.ndarray) -> np.ndarray:
            cells = (points - middle) * [1.0, -1.0] + half
            return np.round((cells / layer.cell - 0.5) * _UNIT).astype(np.int32)

        near = ((lines.high > middle - half - 4) & (lines.low < middle + half + 4)).all(-1)
        some = [lines.polylines[row] for row in np.flatnonzero(near).tolist()]
        ends = np.cumsum([len(line) for line in some])
        roads = np.split(fixed(np.concatenate(some)), ends[:-1]) if some else []
        for width, code in ((LANE_WIDTH + 2 * _SIDEWALK, _WALK), (LANE_WIDTH + 0.3, _ROAD)):
            cv2.polylines(codes, roads, False, code, max(1, round(width / layer.cell)), cv2.LINE_8, _SHIFT)
        palette = np.zeros((256, 1, 3), np.uint8)
        palette[:3, 0] = [_bytes(color) for color in (look.terrain, look.sidewalk, look.road)]
        for segments, width, color, code in (
            (lines.white, _LINE_WIDTH, look.marking, _WHITE),
            (lines.yellow, _LINE_WIDTH, _YELLOW, _YELLOW_LINE),
            (lines.stop, _STOP_WIDTH, look.marking, _STOP_LINE),
        ):
            chosen = segments[(np.abs(segments - middle) < half + 4).all((1, 2))]
            cells = max(1, round(width / layer.cell))
            share = min(1.0, width / (cells * layer.cell))  # lines thinner than a cell are fainter
            palette[code, 0] = _bytes(share * np.array(color) + (1 - share) * np.array(look.road))
            cv2.polylines(codes, list(fixed(chosen)), False, code, cells, cv2.LINE_8, _SHIFT)
        colors = cv2.applyColorMap(codes, np.ascontiguousarray(palette))
        if layer.cell > _NEAR.cell:
            return _Drawn(middle, colors, codes)
        # Cells of the map keep their grain, whatever the window.
        left, top = round((middle[0] - half) / layer.cell), round((middle[1] + half) / layer.cell)
        shade = _grain_tile(count)[-top % _GRAIN_CELLS :, left % _GRAIN_CELLS :][:count, :count]
        return _Drawn(middle, cv2.multiply(colors, shade, scale=1 / 128), codes)


def _near_layer(camera: Camera) -> GroundLayer:
    """The window of what is near: small for a camera that sees little to the sides, for it need not lie all around."""
    left, right = camera.intrinsic[0, 2], camera.width - camera.intrinsic[0, 2]
    slope = max(left, right) / camera.intrinsic[0, 0]
    if slope >= 1:
        return _NEAR
    # The circle through the camera and both corners of what it sees up to the reach.
    radius = _NEAR.reach * (1 + float(slope) ** 2) / 2
    return _NEAR._replace(side=2.0 * math.ceil(radius + _NEAR_SLACK + 1), slack=_NEAR_SLACK, ahead=radius)


@functools.cache
def _grain_tile(count: int) -> UInt8[np.ndarray, "cells cells 3"]:
    """Brightness of cells around 128, fine and coarse, which repeats; one repetition more than so many cells."""
    rng, few = np.random.default_rng(0), _GRAIN_CELLS // 8
    coarse = np.kron(rng.normal(0, 1, (few, few)), np.ones((8, 8)))
    values = 128 * (1 + _GRAIN * (0.7 * rng.normal(0, 1, (_GRAIN_CELLS, _GRAIN_CELLS)) + 0.5 * coarse))
    tile = np.repeat(values.clip(64, 192).round().astype(np.uint8)[..., None], 3, 2)
    repeats = 1 + -(-count // _GRAIN_CELLS)
    return np.tile(tile, (repeats, repeats, 1))


def _bytes(color: Sequence[float] | np.ndarray) -> tuple[int, int, int]:
    red, green, blue = (round(255 * min(max(float(value), 0.0), 1.0)) for value in color)
    return red, green, blue


def _simplified(line: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "m 2"]:
    """Fewer points of a line, which stays within ``_CLOSE``: wide lines of many short parts take long to draw."""
    start = line[0]
    points = require_opencv().approxPolyDP((line - start).astype(np.float32), _CLOSE, False)
    return points.reshape(-1, 2).astype(np.float64) + start


def _lines_of(log: Log) -> _Lines:
    polylines = [
        _simplified(lane.points[:, :2])
        for lane in log.lanes
        if len(lane.points) > 1 and lane.lane_type not in NO_CAR_LANE_TYPES
    ]
    low = np.array([line.min(0) for line in polylines]).reshape(-1, 2)
    high = np.array([line.max(0) for line in polylines]).reshape(-1, 2)
    return _Lines(polylines, low, high, *_markings(lane_sides(log.lanes)), stop_lines(log).ends)


def _markings(sides: Sequence[LaneSide]) -> tuple[Float64[np.ndarray, "n 2 2"], Float64[np.ndarray, "m 2 2"]]:
    """Segments of white and yellow lines beside lanes."""
    if not sides:
        return np.zeros((0, 2, 2)), np.zeros((0, 2, 2))
    points, beside = np.concatenate([side.points[:, :2] for side in sides]), np.concatenate([s.beside for s in sides])
    counts = np.array([len(side.points) for side in sides])
    arc = cumulative_length(points)
    arc = np.round(arc - np.repeat(arc[np.cumsum(counts) - counts], counts), 6)
    dashed = (arc % (_DASH + _GAP) < _DASH) & np.repeat([side.is_left for side in sides], counts)
    rows = np.delete(np.arange(len(points)), np.cumsum(counts) - 1)  # all but the last of each side
    steps, kinds = np.stack([points[rows], points[rows + 1]], 1), beside[rows]
    white = (kinds == OUTSIDE) | ((kinds == SAME_WAY) & dashed[rows])
    return steps[white], steps[kinds == OTHER_WAY]
