"""Animations of logs: a bird's-eye view that follows one object."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from PIL import Image

from scjax.scene import NO_EGO, OTHER_OBJECT, AgentType, Log, Signal
from scjax.scene.files import write_file
from scjax.viz.bev import AGENT_COLORS, EGO, INK, PAPER, ROAD, SIGNAL_COLORS

_LANE_WIDTH = 3.4  # m; maps hold no lane widths, so the band is only a visual aid
_WALK_WIDTH, _WALK = 2.0, "#f0efec"  # m; sidewalks and shoulders, which cars do not drive on
_NO_ROAD = "not_for_cars"  # lane type
_DEFAULT_SIZE = np.array([1.0, 1.0])  # m, where a log does not know the size of an object
_MAX_FRAMES = 600


def animate(
    log: Log, path: str | Path, *, object_index: int | None = None, radius: float = 40.0, frames_per_second: float = 10
) -> None:
    """Writes an animated GIF of a log, at its own speed.

    Args:
      path: of the file, which ends in .gif.
      object_index: the object in the middle, by default the ego; without an ego the middle of the map stays.
      radius: from the middle to the edge of the picture [m].
      frames_per_second: at most; not more than the log has.

    Raises:
      ValueError: if the log has one step only, is longer than 600 frames, or there is no such object.
    """
    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise ValueError(f"{path}: animations are GIF files: give a name that ends in .gif")
    if log.num_steps < 2:
        raise ValueError("the log has one step, which makes no animation: give one with more steps")
    index = log.ego_index if object_index is None else object_index
    if not NO_EGO <= index < log.num_objects:
        raise ValueError(f"object_index is {index}: give one of the {log.num_objects} objects of the log")
    times = log.timestamps - log.timestamps[0]
    frames = np.arange(0.0, times[-1] + 1e-9, max(1.0 / frames_per_second, log.dt))
    if len(frames) > _MAX_FRAMES:
        raise ValueError(f"{len(frames)} frames are more than {_MAX_FRAMES}: cut the log or lower frames_per_second")
    steps = np.unique(np.abs(times[None] - frames[:, None]).argmin(1))
    view = _View(log, index, radius)
    images = [view.draw(int(step)) for step in steps]
    duration = 1000.0 * times[steps[-1]] / (len(steps) - 1)
    write_file(
        path,
        lambda file: images[0].save(
            file, "GIF", save_all=True, append_images=images[1:], duration=round(duration), loop=0
        ),
    )


class _View:
    """A figure whose agents and signals change from step to step."""

    def __init__(self, log: Log, index: int, radius: float):
        self.log, self.index, self.radius = log, index, radius
        figure = Figure(figsize=(5, 5), dpi=96, facecolor=PAPER)
        self.canvas = FigureCanvasAgg(figure)
        self.ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self.ax.set_axis_off()
        self.ax.set_aspect("equal")
        scale = 72 * 5 / (2 * radius)
        lines = [lane.points[:, :2] for lane in log.lanes]
        walks = [line for line, lane in zip(lines, log.lanes, strict=True) if lane.lane_type == _NO_ROAD]
        roads = [line for line, lane in zip(lines, log.lanes, strict=True) if lane.lane_type != _NO_ROAD]
        self.ax.add_collection(LineCollection(walks, colors=_WALK, linewidths=_WALK_WIDTH * scale, zorder=0))
        self.ax.add_collection(LineCollection(roads, colors=ROAD, linewidths=_LANE_WIDTH * scale, zorder=1))
        self.ax.add_collection(LineCollection(roads, colors="#8f949b", linewidths=0.15 * scale, zorder=2))
        rows = {lane.id: row for row, lane in enumerate(log.lanes)}
        self.signals = [row for row, name in enumerate(log.signal_lane_ids) if name in rows]
        lit = [lines[rows[log.signal_lane_ids[row]]] for row in self.signals]
        self.lights = LineCollection(lit, linewidths=0.45 * scale, zorder=3)
        self.ax.add_collection(self.lights)
        self.boxes = PolyCollection([], edgecolors=PAPER, linewidths=0.5, zorder=4)
        self.ax.add_collection(self.boxes)
        self.clock = self.ax.text(0.02, 0.97, "", transform=self.ax.transAxes, va="top", color=INK)

    def draw(self, step: int) -> Image.Image:
        """The picture of one step."""
        log = self.log
        rows = np.flatnonzero(log.valid[:, step]).tolist()
        self.boxes.set_verts([_corners(log, row, step) for row in rows])
        self.boxes.set_facecolor([self._color(row) for row in rows])
        self.lights.set_color([SIGNAL_COLORS[Signal(int(log.signal_states[row, step]))] for row in self.signals])
        x, y = self._middle(step)
        self.ax.set_xlim(x - self.radius, x + self.radius)
        self.ax.set_ylim(y - self.radius, y + self.radius)
        self.clock.set_text(f"{log.timestamps[step]:+.1f} s")
        self.canvas.draw()
        return Image.fromarray(np.asarray(self.canvas.buffer_rgba())[..., :3]).quantize(64)

    def _color(self, row: int) -> str:
        kind = int(self.log.object_types[row])
        if row == self.index:
            return EGO
        return INK if kind == OTHER_OBJECT else AGENT_COLORS[AgentType(kind)]

    def _middle(self, step: int) -> tuple[float, float]:
        log = self.log
        if self.index == NO_EGO:
            points = np.concatenate([lane.points[:, :2] for lane in log.lanes] or [np.zeros((1, 2))])
            return tuple((points.min(0) + points.max(0)) / 2)
        valid = np.flatnonzero(log.valid[self.index])
        if not len(valid):
            return 0.0, 0.0
        nearest = valid[np.abs(valid - step).argmin()]
        return tuple(log.positions[self.index, nearest, :2])


def _corners(log: Log, row: int, step: int) -> np.ndarray:
    """Corners of the box of an object [4, 2]."""
    size = np.where(np.isnan(log.sizes[row, :2]), _DEFAULT_SIZE, log.sizes[row, :2]) / 2
    cos, sin = np.cos(log.headings[row, step]), np.sin(log.headings[row, step])
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * size
    return log.positions[row, step, :2] + corners @ np.array([[cos, sin], [-sin, cos]])
