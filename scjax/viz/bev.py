"""Bird's-eye view of one scene: lanes with direction and signal, lane connections, agent boxes, axes in meters.

Needs matplotlib (the ``viz`` extra). It does not use pyplot, so drawing works in threads and without a display.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from scjax.scene import TILE_SIZE, AgentType, Crop, Link, Scene, Signal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from scjax.scene.per_type import PerType

PAPER, ROAD, KNOWN_ROAD, INK, GRID = "#fbfaf7", "#e9e8e4", "#d6dde4", "#3b4048", "#d9d7d0"
EGO = "#cf3b3b"
AGENT_COLORS = {
    AgentType.VEHICLE: "#4f7fae",
    AgentType.PEDESTRIAN: "#d98a2b",
    AgentType.CYCLIST: "#8a63b5",
    AgentType.STATIC: "#8d8a84",
}
SIGNAL_COLORS = {Signal.UNKNOWN: "#8f949b", Signal.GO: "#2f9e5b", Signal.CAUTION: "#e0a100", Signal.STOP: "#d9483b"}
_LANES = {
    Signal.UNKNOWN: "lane",
    Signal.GO: "green light",
    Signal.CAUTION: "yellow light",
    Signal.STOP: "red light",
}
LEGEND: dict[str, Any] = {
    "frameon": False,
    "fontsize": 7,
    "labelcolor": INK,
    "handlelength": 1.0,
    "handletextpad": 0.5,
    "columnspacing": 1.0,
}
"""Of ``Figure.legend``: all colors in one line below a picture of 6 inches."""
_ROAD_HALF_WIDTH = 1.7  # meters; scenes hold no lane widths, so the band is only a visual aid
_CHEVRON_SPACING = 9.0  # meters of lane per direction mark
_SPEED_HORIZON = 1.0  # seconds of travel shown by a speed arrow


def plot_scene(
    scene: Scene,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    known: PerType | None = None,
    speeds: bool = False,
) -> Axes:
    """Draws one scene in its own frame: x (forward) to the right, y (left) up, in meters.

    Args:
      scene: a single scene, NumPy or JAX arrays.
      ax: where to draw; None: a new figure, 6 inches wide, with a legend (``ax.figure.savefig(path)`` writes it).
      title: a line above the picture.
      known: masks [agents] and [lanes] of elements that the model received: tinted roads and hatched boxes.
      speeds: whether to draw how far every agent travels in one second.

    Returns:
      The axes.

    Raises:
      ValueError: on a batch: index it, or use ``scjax.viz.grid``.
    """
    if scene.batch_shape:
        raise ValueError(
            f"plot_scene draws one scene, this is a batch {scene.batch_shape}: index it or use scjax.viz.grid"
        )
    scene = scene.to_numpy()
    if ax is None:
        figure = Figure(figsize=(6, 6.2), layout="constrained")
        FigureCanvasAgg(figure)
        ax = figure.add_subplot()
        legend_below(figure, [scene])
    scale = _points_per_meter(ax)
    known_lanes = np.zeros(len(scene.lane_mask), bool) if known is None else np.asarray(known.lanes, bool)
    known_agents = np.zeros(len(scene.agent_mask), bool) if known is None else np.asarray(known.agents, bool)
    _draw_lanes(ax, scene, known_lanes, scale)
    _draw_agents(ax, scene, known_agents, scale, speeds)
    _draw_frame(ax, Crop(int(scene.crop)), title)
    return ax


def legend_below(figure: Figure, scenes: Sequence[Scene], *, right: bool = False) -> None:
    """Adds a legend of ``scenes`` at the lower border of a figure with constrained layout, in the middle or right."""
    handles = legend_handles(scenes)
    if handles:
        place = "outside lower right" if right else "outside lower center"
        figure.legend(handles=handles, loc=place, ncols=len(handles), **LEGEND)


def legend_handles(scenes: Sequence[Scene]) -> list[Any]:
    """What colors mean in pictures of ``scenes``: of the ego, the agent types and the states of lanes that occur."""
    host = [scene.to_numpy() for scene in scenes]
    types = {int(t) for scene in host for t in scene.agent_types[1:][scene.agent_mask[1:]]}
    signals = {int(s) for scene in host for s in scene.signals[scene.lane_mask]}
    has_ego = any(scene.agent_mask[:1].any() for scene in host)
    handles: list[Any] = [Patch(color=EGO, label="ego")] if has_ego else []
    handles += [Patch(color=c, label=t.name.lower()) for t, c in AGENT_COLORS.items() if t in types]
    return handles + [Line2D([], [], color=c, label=_LANES[s]) for s, c in SIGNAL_COLORS.items() if s in signals]


def tile_limits(crop: Crop) -> tuple[tuple[float, float], tuple[float, float]]:
    """(x min, x max), (y min, y max) of the tile of a crop [m]."""
    half = TILE_SIZE / 2
    return ((0.0, TILE_SIZE) if crop == Crop.FORWARD else (-half, half)), (-half, half)


def _points_per_meter(ax: Axes) -> float:
    """Scale of line widths: they follow the size of the picture, so that small pictures stay readable."""
    box = ax.get_position()
    figure = ax.get_figure(root=True)
    if figure is None:
        return 72 * 6 / TILE_SIZE
    width, height = figure.get_size_inches()
    return 72 * min(box.width * width, box.height * height) / TILE_SIZE


def _draw_lanes(ax: Axes, scene: Scene, known: np.ndarray, scale: float) -> None:
    rows = np.flatnonzero(scene.lane_mask)
    points = np.asarray(scene.lanes)[rows, :, :2]
    if not len(rows):
        return
    tangents = np.gradient(points, axis=1)
    tangents = tangents / np.maximum(np.linalg.norm(tangents, axis=-1, keepdims=True), 1e-6)
    normals = np.stack([-tangents[..., 1], tangents[..., 0]], -1)
    bands = np.concatenate([points + _ROAD_HALF_WIDTH * normals, (points - _ROAD_HALF_WIDTH * normals)[:, ::-1]], 1)
    roads = np.where(known[rows], KNOWN_ROAD, ROAD).tolist()
    # An edge in the color of the band rounds its corners and closes hairline gaps between neighbors.
    ax.add_collection(
        PolyCollection(
            list(bands),
            facecolors=roads,
            edgecolors=roads,
            linewidths=0.25 * scale,
            joinstyle="round",
            zorder=1,
            gid="roads",
        )
    )
    signals = [Signal(int(s)) for s in scene.signals[rows]]
    colors = [SIGNAL_COLORS[s] for s in signals]
    widths = [max(0.5, (0.2 if s == Signal.UNKNOWN else 0.5) * scale) for s in signals]
    orders = np.argsort([s != Signal.UNKNOWN for s in signals], kind="stable")  # lit lanes on top
    ax.add_collection(
        LineCollection(
            [points[k] for k in orders],
            colors=[colors[k] for k in orders],
            linewidths=[widths[k] for k in orders],
            capstyle="round",
            zorder=2,
            gid="lanes",
        )
    )
    marks, owners = _chevrons(points, tangents)
    ax.add_collection(
        LineCollection(
            marks,
            colors=[colors[k] for k in owners],
            linewidths=max(0.6, 0.25 * scale),
            capstyle="round",
            joinstyle="round",
            zorder=2.1,
            gid="chevrons",
        )
    )
    lanes, successors = np.nonzero((scene.links == Link.PREDECESSOR) & scene.lane_mask[:, None] & scene.lane_mask)
    ends, starts = scene.lanes[lanes, -1, :2], scene.lanes[successors, 0, :2]
    ax.add_collection(
        LineCollection(
            list(np.stack([ends, starts], 1)),
            colors=INK,
            linewidths=max(0.4, 0.15 * scale),
            linestyles="dotted",
            zorder=2.2,
            gid="connections",
        )
    )
    ax.scatter(*starts.T, s=max(0.8, 0.55 * scale) ** 2, color=INK, alpha=0.55, linewidths=0, zorder=2.3)


def _chevrons(points: np.ndarray, tangents: np.ndarray) -> tuple[list[np.ndarray], list[int]]:
    """(direction marks as polylines of three points, index of the lane of each mark)."""
    marks, owners = [], []
    steps = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    for k, lane in enumerate(points):
        arc = np.concatenate([[0.0], np.cumsum(steps[k])])
        count = max(1, round(arc[-1] / _CHEVRON_SPACING))
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


def _draw_agents(ax: Axes, scene: Scene, known: np.ndarray, scale: float, speeds: bool) -> None:
    rows = np.flatnonzero(scene.agent_mask)[::-1]  # the ego last, on top
    if not len(rows):
        return
    agents = scene.agents[rows]
    center, ahead = agents[:, :2], agents[:, 4:6]
    side = np.stack([-ahead[:, 1], ahead[:, 0]], 1)
    half_length, half_width = agents[:, 6:7] / 2, agents[:, 7:8] / 2
    nose, flank = ahead * half_length, side * half_width
    boxes = center[:, None] + np.stack([nose + flank, nose - flank, -nose - flank, -nose + flank], 1)
    types = [AgentType(int(t)) for t in scene.agent_types[rows]]
    colors = [EGO if row == 0 else AGENT_COLORS[t] for row, t in zip(rows, types, strict=True)]
    large = np.array([t in (AgentType.VEHICLE, AgentType.STATIC) for t in types])
    # People are a few pixels in a small picture: a rim of the same color keeps them visible.
    rims = ["white" if big else color for big, color in zip(large, colors, strict=True)]
    rim_widths = np.where(large, max(0.25, 0.12 * scale), max(0.9, 0.2 * scale))
    ax.add_collection(
        PolyCollection(
            list(boxes),
            facecolors=colors,
            edgecolors=rims,
            linewidths=rim_widths.tolist(),
            joinstyle="round",
            zorder=3,
            gid="agents",
        )
    )
    if known[rows].any():
        ax.add_collection(
            PolyCollection(
                list(boxes[known[rows]]),
                facecolors="none",
                edgecolors="white",
                hatch="//////",
                linewidths=0,
                zorder=3.1,
                gid="known",
            )
        )
    # A tick shows the heading: inside a vehicle, in front of a person. Static objects have none.
    tips = np.where(large[:, None], center + 0.8 * nose, center + nose + 0.7 * ahead)
    ticked = np.array([t != AgentType.STATIC for t in types])
    ax.add_collection(
        LineCollection(
            list(np.stack([center, tips], 1)[ticked]),
            capstyle="round",
            zorder=3.2,
            gid="headings",
            colors=[rim for rim, tick in zip(rims, ticked, strict=True) if tick],
            linewidths=max(0.6, 0.28 * scale),
        )
    )
    if speeds:
        fast = agents[:, 3] > 0.3
        start, tip = (center + nose)[fast], (center + nose + ahead * agents[:, 3:4] * _SPEED_HORIZON)[fast]
        barb, spread = 0.8 * ahead[fast], 0.5 * side[fast]
        arrows = np.stack([start, tip, tip - barb + spread, tip, tip - barb - spread], 1)
        ax.add_collection(
            LineCollection(
                list(arrows),
                linewidths=max(0.6, 0.2 * scale),
                zorder=2.9,
                gid="speeds",
                colors=[c for c, f in zip(colors, fast, strict=True) if f],
            )
        )


def _draw_frame(ax: Axes, crop: Crop, title: str | None) -> None:
    (x_min, x_max), (y_min, y_max) = tile_limits(crop)
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
        ax.set_title(title, fontsize=8, color=INK, pad=4, parse_math=False)
