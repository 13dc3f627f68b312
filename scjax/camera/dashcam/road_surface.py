"""The ground around a camera: terrain, sidewalks, roads, markings and shadows, drawn from above and seen in perspective."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from scjax.camera.camera import Camera
from scjax.camera.dashcam.look import Look
from scjax.camera.dashcam.materials import SemanticClass
from scjax.camera.raster import require_opencv
from scjax.camera.road_lines import CROSSING, LANE_WIDTH, OTHER_WAY, OUTSIDE, SAME_WAY, lane_sides, simplified
from scjax.scene import Log
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.scene.polyline import cumulative_length
from scjax.scene.stop_lines import stop_lines

_DASH, _GAP = 3.0, 6.0  # m
_LINE_WIDTH, _STOP_WIDTH, _SIDEWALK = 0.14, 0.45, 2.0  # m
_YELLOW = (0.85, 0.65, 0.15)
_SHIFT, _UNIT = 4, 16.0


@dataclasses.dataclass(frozen=True)
class GroundWindow:
    """A window of the ground ahead of a camera: ``ahead`` m long and twice ``aside`` m wide, in cells of ``cell`` m."""

    behind: float
    ahead: float
    aside: float
    cell: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return round((self.ahead + self.behind) / self.cell), round(2 * self.aside / self.cell)

    def cells(self, points: Float64[np.ndarray, "*b 2"]) -> Float64[np.ndarray, "*b 2"]:
        """Column and row of points ahead of the camera and to its left [m]."""
        rows = (self.ahead - points[..., 0]) / self.cell - 0.5
        columns = (self.aside - points[..., 1]) / self.cell - 0.5
        return np.stack([columns, rows], -1)

    @property
    def matrix(self) -> Float64[np.ndarray, "3 3"]:
        """``cells`` as a matrix of homogeneous points."""
        scale = 1 / self.cell
        return np.array(
            [[0.0, -scale, self.aside * scale - 0.5], [-scale, 0.0, self.ahead * scale - 0.5], [0.0, 0.0, 1.0]]
        )


WINDOWS = (GroundWindow(4.0, 28.0, 20.0, 0.0625), GroundWindow(4.0, 124.0, 64.0, 0.25))
"""The near one is finer; the far one covers the rest of the view."""


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

    Args:
      log: whose lanes are roads.
      look: of the picture.
    """

    def __init__(self, log: Log, look: Look):
        self._lines, self._look = _lines_of(log), look

    def view(
        self,
        camera: Camera,
        rotation: Float64[np.ndarray, "3 3"],
        position: Float64[np.ndarray, " 3"],
        shadows: Sequence[np.ndarray],
    ) -> tuple[
        UInt8[np.ndarray, "height width 3"], UInt8[np.ndarray, "height width"], Float32[np.ndarray, "height width"]
    ]:
        """Colors, ``SemanticClass`` and inverse depth of the ground in a picture; the latter is 0 above the horizon.

        Args:
          rotation, position: of a pinhole camera in the frame of the log, its z above the ground.
          shadows: convex outlines on the ground [n, 2] m.
        """
        cv2 = require_opencv()
        ahead = rotation[:2, 2] if np.hypot(*rotation[:2, 2]) > 1e-6 else -rotation[:2, 1]
        ahead = ahead / np.linalg.norm(ahead)
        frame = np.array([ahead, [-ahead[1], ahead[0]]])  # rows: ahead, left
        inverse = np.linalg.inv(camera.intrinsic)
        plane = (rotation[2] / -position[2]) @ inverse  # inverse depth of the ground of (column, row, 1)
        columns, rows = np.arange(camera.width), np.arange(camera.height)[:, None]
        depth = (plane[0] * columns + (plane[1] * rows + plane[2])).astype(np.float32)
        below = depth > 1e-4
        # Column and row -> place on the ground, ahead and left of the camera, times inverse depth.
        to_ground = np.vstack([frame @ rotation[:2] @ inverse, plane])
        size = (camera.width, camera.height)
        colors, classes = None, None
        for window in reversed(WINDOWS):
            picture, kinds, shade = self._draw(window, frame, position[:2], shadows)
            matrix = window.matrix @ to_ground
            options = {"flags": cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, "borderMode": cv2.BORDER_REPLICATE}
            near = cv2.warpPerspective(picture, matrix, size, **options)
            if shade is not None:
                dark = cv2.warpPerspective(shade, matrix, size, **options)
                near = cv2.multiply(near, cv2.merge([255 - dark] * 3), scale=1 / 255)
            options["flags"] = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
            near_kinds = cv2.warpPerspective(kinds, matrix, size, **options)
            if colors is None or classes is None:
                colors, classes = near, near_kinds
                continue
            inside = self._inside(window, to_ground, columns, rows, depth) & below
            np.copyto(colors, near, where=inside[..., None])
            np.copyto(classes, near_kinds, where=inside)
        assert colors is not None and classes is not None
        classes[~below] = SemanticClass.SKY
        return colors, classes, np.where(below, depth, np.float32(0))

    def _inside(
        self, window: GroundWindow, to_ground: np.ndarray, columns: np.ndarray, rows: np.ndarray, depth: np.ndarray
    ) -> Bool[np.ndarray, "height width"]:
        """Pixels that show the ground of a window."""
        ahead, left = ((m[0] * columns + (m[1] * rows + m[2])) for m in to_ground[:2])
        return (ahead < (window.ahead - 1) * depth) & (np.abs(left) < (window.aside - 1) * depth)

    def _draw(
        self, window: GroundWindow, frame: np.ndarray, origin: np.ndarray, shadows: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Colors, classes and darkness of shadows of a window, from above."""
        cv2 = require_opencv()
        look, lines = self._look, self._lines
        picture = np.empty((*window.shape, 3), np.uint8)
        kinds = np.full(window.shape, SemanticClass.TERRAIN, np.uint8)
        picture[:] = _bytes(look.terrain)
        reach = window.ahead + window.aside
        near = ((lines.high > origin - reach) & (lines.low < origin + reach)).all(-1)
        roads = [_fixed(window, (lines.polylines[row] - origin) @ frame.T) for row in np.flatnonzero(near).tolist()]
        for width, color, kind in (
            (LANE_WIDTH + 2 * _SIDEWALK, look.sidewalk, SemanticClass.SIDEWALK),
            (LANE_WIDTH + 0.3, look.road, SemanticClass.ROAD),
        ):
            pixels = max(1, round(width / window.cell))
            cv2.polylines(picture, roads, False, _bytes(color), pixels, cv2.LINE_8, _SHIFT)
            cv2.polylines(kinds, roads, False, int(kind), pixels, cv2.LINE_8, _SHIFT)
        for segments, width, color in (
            (lines.white, _LINE_WIDTH, look.marking),
            (lines.yellow, _LINE_WIDTH, _YELLOW),
            (lines.stop, _STOP_WIDTH, look.marking),
        ):
            chosen = segments[(np.abs(segments - origin) < reach).all((1, 2))]
            pixels = max(1, round(width / window.cell))
            share = min(1.0, width / (pixels * window.cell))  # lines thinner than a cell are fainter
            mixed = share * np.array(color) + (1 - share) * np.array(look.road)
            ends = list(_fixed(window, (chosen - origin) @ frame.T))
            cv2.polylines(picture, ends, False, _bytes(mixed), pixels, cv2.LINE_AA, _SHIFT)
            cv2.polylines(kinds, ends, False, int(SemanticClass.MARKING), pixels, cv2.LINE_8, _SHIFT)
        return picture, kinds, self._shade(window, frame, origin, shadows)

    def _shade(
        self, window: GroundWindow, frame: np.ndarray, origin: np.ndarray, shadows: Sequence[np.ndarray]
    ) -> np.ndarray | None:
        if not shadows or self._look.shadows < 0.02:
            return None
        cv2 = require_opencv()
        shade = np.zeros(window.shape, np.uint8)
        dark = round(255 * self._look.shadows)
        for outline in shadows:
            cv2.fillConvexPoly(shade, _fixed(window, (outline - origin) @ frame.T), dark, cv2.LINE_AA, _SHIFT)
        return shade


def _fixed(window: GroundWindow, points: np.ndarray) -> np.ndarray:
    return np.round(window.cells(points) * _UNIT).astype(np.int32)


def _bytes(color: Sequence[float] | np.ndarray) -> tuple[int, int, int]:
    red, green, blue = (int(round(255 * min(max(float(value), 0.0), 1.0))) for value in color)
    return red, green, blue


def _lines_of(log: Log) -> _Lines:
    polylines = [
        simplified(lane.points)[:, :2]
        for lane in log.lanes
        if len(lane.points) > 1 and lane.lane_type not in NO_CAR_LANE_TYPES
    ]
    low = np.array([line.min(0) for line in polylines]).reshape(-1, 2)
    high = np.array([line.max(0) for line in polylines]).reshape(-1, 2)
    white, yellow = [np.zeros((0, 2, 2))], [np.zeros((0, 2, 2))]
    for side in lane_sides(log.lanes):
        steps = np.stack([side.points[:-1, :2], side.points[1:, :2]], 1)
        if not len(steps):
            continue
        beside, arc = side.beside[:-1], cumulative_length(side.points)[:-1]
        dashed = (arc % (_DASH + _GAP)) < _DASH
        white += [steps[beside == OUTSIDE], steps[(beside == SAME_WAY) & dashed & side.is_left]]
        yellow.append(steps[beside == OTHER_WAY])
        assert CROSSING not in (OUTSIDE, SAME_WAY, OTHER_WAY)
    return _Lines(polylines, low, high, np.concatenate(white), np.concatenate(yellow), stop_lines(log).ends)
