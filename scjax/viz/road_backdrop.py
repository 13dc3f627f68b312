"""The part of a moving picture that stands still: roads from above, drawn once for a window and cut out for a frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D
from PIL import Image

from scjax.scene import MapLane
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.scene.polyline import cumulative_length
from scjax.viz.bev import PAPER, ROAD

_CURB, _CENTERLINE, _CHEVRON = "#cfcdc6", "#c3c1ba", "#b3b1aa"
_OTHER_LANE = "#f0efec"  # sidewalks, shoulders and bike lanes, on which cars do not drive
_LANE_WIDTH, _CURB_WIDTH, _OTHER_WIDTH, _LINE_WIDTH = 3.5, 0.35, 2.0, 0.14  # m; maps hold no widths of lanes
_CHEVRON_SPACING = 24.0  # m of lane for each mark of its direction
_WINDOW = 2.2  # side of the window that is drawn at once / side of the view
_TURN_SCALE = 1.5  # pixels of the window for each of a picture that is turned


class RoadBackdrop:
    """Pictures of lanes around any place, at ``pixels_per_meter``, ``size`` x ``size`` pixels.

    A window of lanes is drawn with antialiasing, and drawn anew when a view leaves it. Views that look up in a constant
    direction are cut out pixel by pixel, so that nothing flickers.
    """

    def __init__(self, lanes: Sequence[MapLane], pixels_per_meter: float, size: int, *, turns: bool):
        self._size, self._turns = size, turns
        self._scale = pixels_per_meter
        self._window_scale = pixels_per_meter * (_TURN_SCALE if turns else 1.0)
        view = size / pixels_per_meter * (math.sqrt(2.0) if turns else 1.0)
        self._view = view
        self._pixels = math.ceil(_WINDOW * view * self._window_scale)
        drawn = [lane for lane in lanes if len(lane.points) > 1]
        self._lines = [lane.points[:, :2] for lane in drawn]
        self._driven = [lane.lane_type not in NO_CAR_LANE_TYPES for lane in drawn]
        self._marks: dict[int, list[np.ndarray]] = {}  # of the lanes that were in a window so far
        self._low = np.array([line.min(0) for line in self._lines]).reshape(-1, 2)
        self._high = np.array([line.max(0) for line in self._lines]).reshape(-1, 2)
        self._corner: np.ndarray | None = None  # lower left corner of the window [m]
        self._tones = np.zeros((1, 1), np.uint8)  # of the window; one channel is turned three times as fast as three
        self._colors = _colors_of_tones()

    def snap(self, center: np.ndarray) -> np.ndarray:
        """The place next to ``center`` [2] whose view falls on whole pixels of the window [m]."""
        return center if self._turns else np.round(center * self._scale) / self._scale

    def picture(self, center: np.ndarray, up: float) -> UInt8[np.ndarray, "size size 3"]:
        """The roads around ``center`` [2] (of ``snap``), with the direction ``up`` [rad] of the map upwards."""
        if self._corner is None or not self._covers(center):
            self._draw_window(center)
        assert self._corner is not None
        column, row = (center - self._corner) * self._window_scale  # of the center, from the lower left corner
        row = self._pixels - row  # from the top
        if not self._turns:
            left, top = round(column - self._size / 2), round(row - self._size / 2)
            return self._colors[self._tones[top : top + self._size, left : left + self._size]]
        turn, ratio = up - math.pi / 2, self._window_scale / self._scale
        cos, sin = ratio * math.cos(turn), ratio * math.sin(turn)
        half = self._size / 2
        affine = (cos, sin, column - half * (cos + sin), -sin, cos, row - half * (cos - sin))
        view = Image.fromarray(self._tones).transform(
            (self._size, self._size), Image.Transform.AFFINE, affine, Image.Resampling.BILINEAR
        )
        return self._colors[np.asarray(view)]

    def _covers(self, center: np.ndarray) -> bool:
        assert self._corner is not None
        offset = (center - self._corner) * self._window_scale
        margin = self._view * self._window_scale / 2 + 1
        return bool((offset >= margin).all() and (offset <= self._pixels - margin).all())

    def _draw_window(self, center: np.ndarray) -> None:
        """Draws the lanes around ``center``."""
        half = self._pixels / self._window_scale / 2
        self._corner = np.floor((center - half) * self._window_scale) / self._window_scale
        top = self._corner + 2 * half
        pad = _LANE_WIDTH
        near = ((self._high > self._corner - pad) & (self._low < top + pad)).all(-1)
        rows = np.flatnonzero(near).tolist()
        renderer = RendererAgg(self._pixels, self._pixels, 72)
        np.asarray(renderer.buffer_rgba())[:] = np.multiply(to_rgba(PAPER), 255).astype(np.uint8)
        scale, corner = self._window_scale, self._corner
        # Lines are shifted in float64: the renderer would lose centimeters of coordinates that are kilometers long.
        lines = {row: Outline((self._lines[row] - corner) * scale) for row in rows}
        roads = [lines[row] for row in rows if self._driven[row]]
        others = [lines[row] for row in rows if not self._driven[row]]
        draw_lines(renderer, others, _OTHER_LANE, _OTHER_WIDTH * scale)
        draw_lines(renderer, roads, _CURB, (_LANE_WIDTH + 2 * _CURB_WIDTH) * scale)
        draw_lines(renderer, roads, ROAD, _LANE_WIDTH * scale)
        draw_lines(renderer, roads, _CENTERLINE, max(0.7, _LINE_WIDTH * scale))
        for row in rows:
            if row not in self._marks:
                self._marks[row] = _chevrons(self._lines[row]) if self._driven[row] else []
        marks = [Outline((mark - corner) * scale) for row in rows for mark in self._marks[row]]
        draw_lines(renderer, marks, _CHEVRON, max(0.9, 0.22 * scale))
        self._tones = np.asarray(renderer.buffer_rgba())[..., 1].copy()


def _colors_of_tones() -> np.ndarray:
    """The color of every green value [256, 3], between those of roads and paper, which grow lighter together."""
    shades = sorted(
        tuple(np.multiply(to_rgb(c), 255)) for c in (_CHEVRON, _CENTERLINE, _CURB, ROAD, _OTHER_LANE, PAPER)
    )
    tones = np.array(shades)[:, 1]
    return (
        np.stack([np.interp(np.arange(256), tones, column) for column in np.array(shades).T], -1)
        .round()
        .astype(np.uint8)
    )


def draw_lines(renderer: RendererAgg, lines: Sequence[Outline], color: str, width: float, opacity: float = 1.0) -> None:
    """Draws lines in pixels from the lower left corner, ``width`` pixels wide, with round ends."""
    context = renderer.new_gc()
    context.set_foreground(color)
    context.set_alpha(opacity)
    context.set_linewidth(width)  # points, which are pixels at 72 dpi
    context.set_capstyle("round")
    context.set_joinstyle("round")
    place = Affine2D()
    for line in lines:
        renderer.draw_path(context, line, place)


def _chevrons(line: np.ndarray) -> list[np.ndarray]:
    """Marks of the direction of a lane, lines of three points [m]."""
    arc = cumulative_length(line)
    if arc[-1] < 6.0:
        return []
    count = max(1, round(arc[-1] / _CHEVRON_SPACING))
    marks = []
    for at in (np.arange(count) + 0.5) / count * arc[-1]:
        tip, behind = (np.array([np.interp(s, arc, column) for column in line.T]) for s in (at, at - 1.0))
        ahead = (tip - behind) / max(float(np.linalg.norm(tip - behind)), 1e-9)
        side = 0.7 * np.array([-ahead[1], ahead[0]])
        marks.append(np.stack([tip - 0.7 * ahead + side, tip, tip - 0.7 * ahead - side]))
    return marks
