"""Frames of a log from above: roads, stop lines of signals, agents with their trails, the clock."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import UInt8
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.colors import to_rgb
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D

from scjax.scene import NO_EGO, AgentType, Log, Signal
from scjax.scene.stop_lines import stop_lines
from scjax.viz.agent_shapes import GLASS, GLASS_OPACITY, agent_shape, rounded_box
from scjax.viz.bev import AGENT_COLORS, EGO, INK, SIGNAL_COLORS
from scjax.viz.road_backdrop import RoadBackdrop, draw_lines

_TRAIL_SECONDS, _TRAIL_OPACITY = 1.2, 0.28
_SHADOW = (0.25, 0.13)  # offset [m] to the lower right, opacity
_SMALLEST = 6.0  # pixels; people are drawn that large at least
_MOVING = 0.5  # m/s; slower agents leave no trail
_STOP_LINE_WIDTH = 0.7  # m
_AHEAD = 0.35  # of the radius, that a picture with the heading up shows more ahead than behind
_SCALE_BARS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)  # m


class LogFrames:
    """Draws single steps of a log.

    Args:
      log: that is drawn.
      index: of the object that stays in the middle; ``NO_EGO``: the picture stands still.
      center: of a picture that stands still [2] m.
      radius: from the middle to the edge of the picture [m].
      size: width and height [pixels].
      heading_up: turn the picture so that the object looks up.
    """

    def __init__(self, log: Log, index: int, center: np.ndarray, radius: float, size: int, *, heading_up: bool):
        self._log, self._index, self._center, self._size = log, index, center, size
        self._scale = size / (2 * radius)  # pixels per meter
        self._radius, self._turns = radius, heading_up and index != NO_EGO
        self._roads = RoadBackdrop(log.lanes, self._scale, size, turns=self._turns)
        smallest = _SMALLEST / self._scale
        self._shapes = [agent_shape(int(k), row, smallest) for k, row in zip(log.object_types, log.sizes, strict=True)]
        self._stop_lines = stop_lines(log)
        self._stop_middles = np.array([line.mean(0) for line in self._stop_lines.ends]).reshape(-1, 2)
        self._font = FontProperties(size=max(10.0, size / 36))
        self._speeds = np.hypot(*np.moveaxis(log.velocities, -1, 0))
        self._left = np.stack([-np.sin(log.headings), np.cos(log.headings)], -1)
        self._trails = np.fmax(0.35 * log.sizes[:, 1], 0.4)  # half the width at the agent [m]

    def draw(self, step: int) -> UInt8[np.ndarray, "size size 3"]:
        """The picture of one step."""
        center, up = self._pose(step)
        center = self._roads.snap(center)
        renderer = RendererAgg(self._size, self._size, 72)
        canvas = np.asarray(renderer.buffer_rgba())
        canvas[..., :3] = self._roads.picture(center, up)
        canvas[..., 3] = 255
        turn = math.pi / 2 - up
        cos, sin = self._scale * math.cos(turn), self._scale * math.sin(turn)
        matrix = np.array([[cos, sin], [-sin, cos]])  # points [n, 2] @ matrix: pixels from the middle

        def to_pixels(points: np.ndarray) -> np.ndarray:
            return (points - center) @ matrix + self._size / 2

        self._draw_signals(renderer, step, center, to_pixels)
        reach = self._radius * (1.5 if self._turns else 1.1) + 12.0
        near = np.abs(self._log.positions[:, step, :2] - center).max(-1, initial=0.0) < reach
        rows = np.flatnonzero(self._log.valid[:, step] & near)
        rows = rows[np.argsort(rows == self._index, kind="stable")]  # the followed object on top
        self._draw_trails(renderer, rows, step, to_pixels)
        self._draw_agents(renderer, rows, step, turn, to_pixels)
        self._draw_texts(renderer, step)
        return canvas[..., :3].copy()

    def _pose(self, step: int) -> tuple[np.ndarray, float]:
        """Center of the picture [2] m and the direction that is up in it [rad]."""
        if self._index == NO_EGO:
            return self._center, math.pi / 2
        valid = np.flatnonzero(self._log.valid[self._index])
        nearest = valid[np.abs(valid - step).argmin()]
        center = self._log.positions[self._index, nearest, :2]
        if not self._turns:
            return center, math.pi / 2
        around = valid[np.abs(valid - nearest) <= 3]  # smooth: recorded headings of slow cars shake
        headings = self._log.headings[self._index, around]
        ahead = np.array([np.cos(headings).mean(), np.sin(headings).mean()])
        up = float(np.arctan2(ahead[1], ahead[0]))
        return center + _AHEAD * self._radius * np.array([math.cos(up), math.sin(up)]), up

    def _draw_signals(self, renderer: RendererAgg, step: int, center: np.ndarray, to_pixels) -> None:
        rows, ends = self._stop_lines
        near = np.abs(self._stop_middles - center).max(-1, initial=0.0) < 1.5 * self._radius + 5
        order = sorted(np.flatnonzero(near), key=lambda k: int(self._log.signal_states[rows[k], step]))
        lines = {int(k): Outline(to_pixels(ends[k])) for k in order}
        width = max(2.5, _STOP_LINE_WIDTH * self._scale)
        draw_lines(renderer, list(lines.values()), "white", width + max(1.5, 0.3 * self._scale))
        for k, line in lines.items():
            state = Signal(int(self._log.signal_states[rows[k], step]))
            draw_lines(renderer, [line], SIGNAL_COLORS[state], width)

    def _draw_trails(self, renderer: RendererAgg, rows: np.ndarray, step: int, to_pixels) -> None:
        """Where agents were in the last ``_TRAIL_SECONDS``, as wedges that end in points."""
        log, context = self._log, renderer.new_gc()
        context.set_linewidth(0.0)
        first = int(np.searchsorted(log.timestamps, log.timestamps[step] - _TRAIL_SECONDS - 1e-6))
        for row in rows.tolist():
            steps = first + np.flatnonzero(log.valid[row, first : step + 1])
            if len(steps) < 3 or not (self._speeds[row, steps] > _MOVING).any():
                continue
            line, share = log.positions[row, steps, :2], np.linspace(0.0, 1.0, len(steps))[:, None]
            aside = share * self._trails[row] * self._left[row, steps]
            wedge = Outline(to_pixels(np.concatenate([line + aside, (line - aside)[::-1]])))
            renderer.draw_path(context, wedge, Affine2D(), (*to_rgb(self._color(row)), _TRAIL_OPACITY))

    def _draw_agents(self, renderer: RendererAgg, rows: np.ndarray, step: int, turn: float, to_pixels) -> None:
        log, context = self._log, renderer.new_gc()
        context.set_linewidth(0.0)
        rim = renderer.new_gc()
        rim.set_foreground("white")
        rim.set_linewidth(max(0.8, 0.16 * self._scale))
        places = to_pixels(log.positions[rows, step, :2])
        for row, (x, y) in zip(rows.tolist(), places, strict=True):
            shape, color = self._shapes[row], to_rgb(self._color(row))
            angle = float(log.headings[row, step]) + turn
            cos, sin = self._scale * math.cos(angle), self._scale * math.sin(angle)
            place = Affine2D.from_values(cos, sin, -sin, cos, float(x), float(y))
            drop = _SHADOW[0] * self._scale
            renderer.draw_path(context, shape.body, place + Affine2D().translate(drop, -drop), (0, 0, 0, _SHADOW[1]))
            if row == self._index:
                halo = renderer.new_gc()
                halo.set_foreground((*color, 0.3), isRGBA=True)
                halo.set_linewidth(max(4.0, 1.2 * self._scale))
                halo.set_joinstyle("round")
                renderer.draw_path(halo, shape.body, place)
            renderer.draw_path(rim, shape.body, place, color)
            for pane in shape.glass:
                renderer.draw_path(context, pane, place, (*to_rgb(GLASS), GLASS_OPACITY))
            if shape.rider is not None:
                dark = 0.62 * np.array(color)
                renderer.draw_path(context, shape.rider, place, (*dark.tolist(), 1.0))

    def _color(self, row: int) -> str:
        kind = int(self._log.object_types[row])
        if row == self._index:
            return EGO
        return INK if kind < 0 else AGENT_COLORS[AgentType(kind)]

    def _draw_texts(self, renderer: RendererAgg, step: int) -> None:
        """The time, the speed of the followed object, and a scale."""
        log, size = self._log, self._size
        words = f"{log.timestamps[step] - log.timestamps[0]:.1f} s"
        if self._index != NO_EGO and log.valid[self._index, step]:
            words += f"   {3.6 * self._speeds[self._index, step]:.0f} km/h"
        edge = 0.025 * size
        width, height, descent = renderer.get_text_width_height_descent(words, self._font, False)
        pad = 0.5 * height
        self._draw_plate(renderer, edge + pad, size - edge - pad - height, width, height, pad)
        context = renderer.new_gc()
        context.set_foreground(INK)
        renderer.draw_text(context, edge + pad, edge + pad + height - descent, words, self._font, 0.0)
        length = max(bar for bar in _SCALE_BARS if bar <= max(0.5 * self._radius, 1.0))
        right, low, pixels = size - edge, edge, length * self._scale
        label = f"{length} m"
        width, height, descent = renderer.get_text_width_height_descent(label, self._font, False)
        self._draw_plate(renderer, right - pixels, low, pixels, height + 4, 4.0)
        bar = [[right - pixels, low + 4], [right - pixels, low], [right, low], [right, low + 4]]
        draw_lines(renderer, [Outline(bar)], INK, 1.4)
        renderer.draw_text(context, right - (pixels + width) / 2, size - low - 6 - descent, label, self._font, 0.0)

    def _draw_plate(self, renderer: RendererAgg, x: float, y: float, width: float, height: float, pad: float) -> None:
        """A white plate behind words, from its lower left corner, all in pixels."""
        x, y, width, height = x - pad, y - pad, width + 2 * pad, height + 2 * pad
        context = renderer.new_gc()
        context.set_linewidth(0.0)
        plate = rounded_box(width, height, 6.0, 6.0)
        renderer.draw_path(context, plate, Affine2D().translate(x + width / 2, y + height / 2), (1.0, 1.0, 1.0, 0.85))
