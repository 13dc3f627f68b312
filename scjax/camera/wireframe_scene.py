"""What a wireframe shows of a log at each step: lines on the road and boxes, in the frame of the log."""

from __future__ import annotations

import enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int, UInt8

from scjax.camera.agent_boxes import box_corners_3d
from scjax.camera.palettes import Palette
from scjax.camera.road_lines import border_segments, center_line_segments
from scjax.camera.signal_places import HEAD_HEIGHT, HEAD_SIZE, signal_places
from scjax.camera.source_log import SNAP_DISTANCE, LogGround, known_sizes
from scjax.scene import NO_EGO, Log, Signal

_SLACK = 30.0  # m beyond the far plane, within which boxes and lines are looked at


class ElementKind(enum.IntEnum):
    """What a pixel of a wireframe belongs to."""

    NOTHING = 0
    LANE = 1
    BORDER = 2
    STOP_LINE = 3
    SIGNAL = 4
    BOX = 5


class WorldLines(NamedTuple):
    """Straight lines.

    Attributes:
      first, second: ends [m].
      colors: RGB.
      kinds: ``ElementKind``.
      ids: index of the lane, or of the signal.
    """

    first: Float64[np.ndarray, "n 3"]
    second: Float64[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]
    kinds: Int[np.ndarray, " n"]
    ids: Int[np.ndarray, " n"]


class WorldBoxes(NamedTuple):
    """Upright boxes.

    Attributes:
      corners: as of ``box_corners_3d`` [m].
      colors: RGB.
      kinds: ``ElementKind``: boxes of objects, or heads of signals.
      ids: index of the object, or of the signal.
    """

    corners: Float64[np.ndarray, "n 8 3"]
    colors: UInt8[np.ndarray, "n 3"]
    kinds: Int[np.ndarray, " n"]
    ids: Int[np.ndarray, " n"]


class WireframeScene:
    """Lines and boxes of a log.

    Args:
      log: that is shown.
      ground: of the log.
      palette: of the colors.
      borders: show borders of the road.
      left_out: index of the object that is not shown; ``NO_EGO`` for none.
      snap_to_ground: put boxes that float or sink by less than ``SNAP_DISTANCE`` on the ground.
    """

    def __init__(
        self,
        log: Log,
        ground: LogGround,
        palette: Palette,
        *,
        borders: bool = True,
        left_out: int = NO_EGO,
        snap_to_ground: bool = False,
    ):
        self._log, self._ground, self._palette = log, ground, palette
        self._left_out, self._snap = left_out, snap_to_ground
        self._sizes = known_sizes(log)
        lanes, sides = center_line_segments(log.lanes), border_segments(log.lanes if borders else ())
        self._signals = signal_places(log)
        line_count = len(self._signals.rows)
        # Lanes last: they are drawn over the borders that they cross.
        self._first = np.concatenate([sides.first, lanes.first, self._signals.lines[:, 0]])
        self._second = np.concatenate([sides.second, lanes.second, self._signals.lines[:, 1]])
        counts = (len(sides.lanes), len(lanes.lanes), line_count)
        self._kinds = np.repeat([ElementKind.BORDER, ElementKind.LANE, ElementKind.STOP_LINE], counts)
        self._ids = np.concatenate([sides.lanes, lanes.lanes, self._signals.rows])
        self._colors = np.repeat(np.array([palette.border, palette.lane, palette.stop_line], np.uint8), counts, axis=0)
        rows = {lane.id: row for row, lane in enumerate(log.lanes)}
        self._lane_of_signal = np.array([rows.get(name, -1) for name in log.signal_lane_ids], int)

    def lines(self, step: int, position: Float64[np.ndarray, " 3"], far: float) -> WorldLines:
        """Lines near ``position`` at a step."""
        reach = far + _SLACK
        low, high = np.minimum(self._first, self._second)[:, :2], np.maximum(self._first, self._second)[:, :2]
        near = ((high > position[:2] - reach) & (low < position[:2] + reach)).all(-1)
        rows = np.flatnonzero(near)
        first, second, kinds, ids = self._first[rows], self._second[rows], self._kinds[rows], self._ids[rows]
        for ends in (first, second):
            unknown = np.isnan(ends[:, 2])
            if unknown.any():
                ends[unknown, 2] = self._ground.heights(ends[unknown, :2], step)
        return WorldLines(first, second, self._line_colors(step, rows, kinds, ids), kinds, ids)

    def _line_colors(self, step: int, rows: np.ndarray, kinds: np.ndarray, ids: np.ndarray) -> np.ndarray:
        colors = self._colors[rows]
        states = np.asarray(self._log.signal_states)[:, step]
        if not len(states):
            return colors
        stop = kinds == ElementKind.STOP_LINE
        colors[stop] = self._palette.signal_colors(states[ids[stop]])
        if self._palette.recolors_lanes:
            lane_states = np.zeros(len(self._log.lanes) + 1, int)
            np.maximum.at(lane_states, self._lane_of_signal, states)
            lane_states[-1] = Signal.UNKNOWN  # of signals without a lane
            lit = (kinds == ElementKind.LANE) & (lane_states[ids] != Signal.UNKNOWN)
            colors[lit] = self._palette.signal_colors(lane_states[ids[lit]])
        return colors

    def boxes(self, step: int, position: Float64[np.ndarray, " 3"], far: float) -> WorldBoxes:
        """Boxes of objects near ``position`` at a step, and heads of signals whose state is known."""
        log, reach = self._log, far + _SLACK
        near = np.abs(log.positions[:, step, :2] - position[:2]).max(-1, initial=0.0) < reach
        valid = log.valid[:, step] & near
        if self._left_out != NO_EGO:
            valid[self._left_out] = False
        rows = np.flatnonzero(valid)
        centers, sizes = log.positions[rows, step], self._sizes[rows]
        centers = self._grounded(centers, sizes, step)
        corners = box_corners_3d(centers, log.headings[rows, step], sizes)
        colors = self._palette.agent_colors(np.asarray(log.object_types)[rows], sizes[:, 0])
        kinds = np.full(len(rows), ElementKind.BOX)
        heads = self._heads(step, position, reach)
        return WorldBoxes(*(np.concatenate(pair) for pair in zip((corners, colors, kinds, rows), heads, strict=True)))

    def _grounded(self, centers: np.ndarray, sizes: np.ndarray, step: int) -> np.ndarray:
        """Centers of boxes with a z each."""
        unknown = np.isnan(centers[:, 2])
        chosen = np.ones(len(centers), bool) if self._snap else unknown
        if not chosen.any():
            return centers
        centers = centers.copy()
        stand = self._ground.heights(centers[chosen, :2], step) + sizes[chosen, 2] / 2
        before = centers[chosen, 2]
        moved = np.isnan(before) | (np.abs(before - stand) < SNAP_DISTANCE)
        centers[chosen, 2] = np.where(moved, stand, before)
        return centers

    def _heads(self, step: int, position: np.ndarray, reach: float) -> WorldBoxes:
        signals = self._signals
        states = np.asarray(self._log.signal_states)[signals.rows, step]
        near = np.abs(signals.heads[:, :2] - position[:2]).max(-1, initial=0.0) < reach
        rows = np.flatnonzero(near & (states != Signal.UNKNOWN))
        centers = signals.heads[rows]
        centers[:, 2] += HEAD_HEIGHT
        unknown = np.isnan(centers[:, 2])
        centers[unknown, 2] = HEAD_HEIGHT + self._ground.heights(centers[unknown, :2], step)
        sizes = np.tile(HEAD_SIZE, (len(rows), 1))
        return WorldBoxes(
            box_corners_3d(centers, signals.headings[rows], sizes),
            self._palette.signal_colors(states[rows]),
            np.full(len(rows), ElementKind.SIGNAL),
            signals.rows[rows],
        )
