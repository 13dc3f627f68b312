"""Bird's-eye view of one scene: lanes with direction and signal, joints, boxes by class, metric axes.

Needs matplotlib (the ``viz`` extra). No pyplot state is touched: drawing works in threads and without a display.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from scjax.scene import TILE_SIZE, AgentType, Crop, Link, Scene, Signal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from scjax.scene.per_type import PerType

PAPER, ROAD, GIVEN_ROAD, INK, GRID = "#fbfaf7", "#e9e8e4", "#d6dde4", "#3b4048", "#d9d7d0"
EGO = "#cf3b3b"
AGENT_COLOURS = {
    AgentType.VEHICLE: "#4f7fae",
    AgentType.PEDESTRIAN: "#d98a2b",
    AgentType.CYCLIST: "#8a63b5",
    AgentType.STATIC: "#8d8a84",
}
SIGNAL_COLOURS = {Signal.UNKNOWN: "#8f949b", Signal.GO: "#2f9e5b", Signal.CAUTION: "#e0a100", Signal.STOP: "#d9483b"}
_ROAD_HALF_WIDTH = 1.7  # metres; scenes hold no lane widths, the band only helps the eye
_CHEVRON_EVERY = 9.0  # metres of lane per direction mark
_SPEED_HORIZON = 1.0  # seconds of travel that a speed arrow shows


def plot_scene(
    scene: Scene,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    known: PerType | None = None,
    speeds: bool = False,
) -> Axes:
    """Draws one scene in its own frame: x (forward) to the right, y (left) up, metres.

    Args:
      scene: a single scene, NumPy or JAX arrays.
      ax: where to draw; a new 6 x 6 inch figure if None (``ax.figure.savefig(path)`` writes it).
      title: a line above the picture.
      known: bool [No] and [Nl], elements that were given to the model: their roads are tinted, their boxes hatched.
      speeds: also draws how far every agent travels in one second.

    Raises:
      ValueError: on a batch: index it, or use ``scjax.viz.grid``.
    """
    if scene.batch_shape:
        raise ValueError(f"plot draws one scene, this is a batch {scene.batch_shape}: index it or use scjax.viz.grid")
    scene = scene.to_numpy()
    if ax is None:
        figure = Figure(figsize=(6, 6), layout="constrained")
        FigureCanvasAgg(figure)
        ax = figure.add_subplot()
    scale = _points_per_metre(ax)
    known_lanes_share = np.zeros(len(scene.lane_mask), bool) if known is None else np.asarray(known.lanes, bool)
    agents_given = np.zeros(len(scene.agent_mask), bool) if known is None else np.asarray(known.agents, bool)
    _draw_lanes(ax, scene, known_lanes_share, scale)
    _draw_agents(ax, scene, agents_given, scale, speeds)
    _draw_frame(ax, Crop(int(scene.crop)), title)
    return ax


def window(crop: Crop) -> tuple[tuple[float, float], tuple[float, float]]:
    """(x min, x max), (y min, y max) of a layout's square [m]."""
    half = TILE_SIZE / 2
    return ((0.0, TILE_SIZE) if crop == Crop.FORWARD else (-half, half)), (-half, half)


def _points_per_metre(ax: Axes) -> float:
    """Line widths follow the size of the picture, so that small ones stay readable."""
    box = ax.get_position()
    figure = ax.get_figure(root=True)
    if figure is None:
        return 72 * 6 / TILE_SIZE
    width, height = figure.get_size_inches()
    return 72 * min(box.width * width, box.height * height) / TILE_SIZE


def _draw_lanes(ax: Axes, scene: Scene, given: np.ndarray, scale: float) -> None:
    rows = np.flatnonzero(scene.lane_mask)
    points = np.asarray(scene.lanes)[rows, :, :2]
    if not len(rows):
        return
    tangents = np.gradient(points, axis=1)
    tangents = tangents / np.maximum(np.linalg.norm(tangents, axis=-1, keepdims=True), 1e-6)
    normals = np.stack([-tangents[..., 1], tangents[..., 0]], -1)
    bands = np.concatenate([points + _ROAD_HALF_WIDTH * normals, (points - _ROAD_HALF_WIDTH * normals)[:, ::-1]], 1)
    roads = np.where(given[rows], GIVEN_ROAD, ROAD).tolist()
    # An edge of its own colour rounds the band's corners and closes hairlines between neighbours.
    ax.add_collection(
        PolyCollection(list(bands), facecolors=roads, edgecolors=roads, linewidths=0.25 * scale, joinstyle="round",
                       zorder=1, gid="roads")
    )  # fmt: skip
    signals = [Signal(int(s)) for s in scene.signals[rows]]
    colours = [SIGNAL_COLOURS[s] for s in signals]
    widths = [max(0.5, (0.2 if s == Signal.UNKNOWN else 0.5) * scale) for s in signals]
    orders = np.argsort([s != Signal.UNKNOWN for s in signals], kind="stable")  # lit lanes on top
    ax.add_collection(
        LineCollection([points[k] for k in orders], colors=[colours[k] for k in orders],
                       linewidths=[widths[k] for k in orders], capstyle="round", zorder=2, gid="lanes")
    )  # fmt: skip
    marks, owners = _chevrons(points, tangents)
    ax.add_collection(
        LineCollection(marks, colors=[colours[k] for k in owners], linewidths=max(0.6, 0.25 * scale),
                       capstyle="round", joinstyle="round", zorder=2.1, gid="chevrons")
    )  # fmt: skip
    before, after = np.nonzero((scene.links == Link.PREDECESSOR) & scene.lane_mask[:, None] & scene.lane_mask)
    ends, starts = scene.lanes[before, -1, :2], scene.lanes[after, 0, :2]
    ax.add_collection(
        LineCollection(list(np.stack([ends, starts], 1)), colors=INK, linewidths=max(0.4, 0.15 * scale),
                       linestyles="dotted", zorder=2.2, gid="joints")
    )  # fmt: skip
    ax.scatter(*starts.T, s=max(0.8, 0.55 * scale) ** 2, color=INK, alpha=0.55, linewidths=0, zorder=2.3)


def _chevrons(points: np.ndarray, tangents: np.ndarray) -> tuple[list[np.ndarray], list[int]]:
    """Direction marks, polylines of three points, and the lane that each belongs to."""
    marks, owners = [], []
    steps = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    for k, lane in enumerate(points):
        arc = np.concatenate([[0.0], np.cumsum(steps[k])])
        count = max(1, round(arc[-1] / _CHEVRON_EVERY))
        if arc[-1] < 2.0:
            continue
        for at in (np.arange(count) + 0.5) / count * arc[-1]:
            tip = np.array([np.interp(at, arc, lane[:, d]) for d in (0, 1)])
            ahead = tangents[k, min(np.searchsorted(arc, at), len(lane) - 1)]
            side = np.array([-ahead[1], ahead[0]])
            back, spread = tip - 0.5 * ahead, 0.65 * side
            marks.append(np.stack([back + spread, tip + 0.4 * ahead, back - spread]))
            owners.append(k)
    return marks, owners


def _draw_agents(ax: Axes, scene: Scene, given: np.ndarray, scale: float, speeds: bool) -> None:
    rows = np.flatnonzero(scene.agent_mask)[::-1]  # the ego last, on top
    if not len(rows):
        return
    agents = scene.agents[rows]
    centre, ahead = agents[:, :2], agents[:, 4:6]
    side = np.stack([-ahead[:, 1], ahead[:, 0]], 1)
    half_length, half_width = agents[:, 6:7] / 2, agents[:, 7:8] / 2
    nose, flank = ahead * half_length, side * half_width
    boxes = centre[:, None] + np.stack([nose + flank, nose - flank, -nose - flank, -nose + flank], 1)
    types = [AgentType(int(t)) for t in scene.agent_types[rows]]
    colours = [EGO if row == 0 else AGENT_COLOURS[kind] for row, kind in zip(rows, types, strict=True)]
    large = np.array([kind in (AgentType.VEHICLE, AgentType.STATIC) for kind in types])
    # People are a few pixels in a small picture: a rim of their own colour keeps them in sight.
    rims = ["white" if big else colour for big, colour in zip(large, colours, strict=True)]
    rim_widths = np.where(large, max(0.25, 0.12 * scale), max(0.9, 0.2 * scale))
    ax.add_collection(
        PolyCollection(list(boxes), facecolors=colours, edgecolors=rims, linewidths=rim_widths.tolist(),
                       joinstyle="round", zorder=3, gid="agents")
    )  # fmt: skip
    if given[rows].any():
        ax.add_collection(
            PolyCollection(list(boxes[given[rows]]), facecolors="none", edgecolors="white", hatch="//////",
                           linewidths=0, zorder=3.1, gid="given")
        )  # fmt: skip
    # A tick tells nose from tail: inside a vehicle, ahead of a person. Static objects have neither.
    tips = np.where(large[:, None], centre + 0.8 * nose, centre + nose + 0.7 * ahead)
    ticked = np.array([kind != AgentType.STATIC for kind in types])
    ax.add_collection(
        LineCollection(list(np.stack([centre, tips], 1)[ticked]), capstyle="round", zorder=3.2, gid="headings",
                       colors=[rim for rim, tick in zip(rims, ticked, strict=True) if tick],
                       linewidths=max(0.6, 0.28 * scale))
    )  # fmt: skip
    if speeds:
        fast = agents[:, 3] > 0.3
        start, tip = (centre + nose)[fast], (centre + nose + ahead * agents[:, 3:4] * _SPEED_HORIZON)[fast]
        barb, spread = 0.8 * ahead[fast], 0.5 * side[fast]
        arrows = np.stack([start, tip, tip - barb + spread, tip, tip - barb - spread], 1)
        ax.add_collection(
            LineCollection(list(arrows), linewidths=max(0.6, 0.2 * scale), zorder=2.9, gid="speeds",
                           colors=[c for c, f in zip(colours, fast, strict=True) if f])
        )  # fmt: skip


def _draw_frame(ax: Axes, crop: Crop, title: str | None) -> None:
    (x_min, x_max), (y_min, y_max) = window(crop)
    ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="equal", facecolor=PAPER)
    ticks = np.arange(0, TILE_SIZE + 1, TILE_SIZE / 4)
    ax.set_xticks(ticks + x_min)
    ax.set_yticks(ticks + y_min)
    ax.tick_params(length=0, labelsize=7, labelcolor=INK)
    ax.set_xlabel("x [m]", fontsize=7, color=INK, labelpad=1)
    ax.set_ylabel("y [m]", fontsize=7, color=INK, labelpad=-2)
    ax.grid(color=GRID, linewidth=0.4, zorder=0)
    ax.set_axisbelow(True)
    for spine in ax.spines.values():
        spine.set(color="#b9b6ae", linewidth=0.6)
    if crop == Crop.PARTITIONED:
        ax.axvline(0, color=INK, linewidth=0.7, linestyle=(0, (6, 4)), zorder=4)
    if title is not None:
        ax.set_title(title, fontsize=8, color=INK, pad=4)
