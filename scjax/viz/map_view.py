"""Overview of a map from above: lanes with their direction, lights, agents, borders of tiles, seams and routes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from scjax.scene import AgentType, Map, MapLane, Signal, TileStatus, route_line
from scjax.scene.boxes import corners
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.scene.polyline import cumulative_length
from scjax.viz.bev import AGENT_COLORS, GRID, INK, PAPER, SIGNAL_COLORS
from scjax.viz.grid import save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STATUS_COLORS = {
    TileStatus.KNOWN: INK,
    TileStatus.COMPLETE: "#2f9e5b",
    TileStatus.INCOMPLETE: "#e0a100",
    TileStatus.MISSING: "#d9483b",
}
SEAM, ROUTE = "#8a63b5", "#1f6fd1"
BAND, OTHER_LANE = "#dddbd5", "#d5d0c4"
_LANE_WIDTH = 3.4  # m; maps hold no lane widths, so the band is only a visual aid
_SIZES = {
    AgentType.VEHICLE: (4.5, 2.0),
    AgentType.PEDESTRIAN: (0.8, 0.8),
    AgentType.CYCLIST: (1.8, 0.8),
    AgentType.STATIC: (0.6, 0.6),
}  # m, of boxes whose size is not known
_LONGEST_EDGE, _SHORTEST_EDGE = 9.0, 3.0  # inches
_ARROW_SPACING = 40.0  # m of lane per arrow
_MAX_ARROWS = 4000


def plot_map(
    map: Map,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    legend: bool = True,
    path: str | Path | None = None,
    dpi: int = 130,
) -> Axes:
    """Draws a map in its own frame: x to the right, y up, in meters.

    Lanes for cars are bands with arrows; all other lanes are thin lines. Dots are where lanes follow each other, rings
    are stop points of lights. A tile is outlined in the color of its status and numbered; a seam is a thick line.

    Args:
      ax: where to draw; a new figure with the aspect of the map if None.
      title: a line above the picture.
      legend: whether to explain, beside the picture, what is in it.
      path: PNG or SVG file to write as well.
      dpi: resolution of that file.

    Returns:
      The axes.

    Raises:
      ValueError: the map is empty.
    """
    if not map.lanes and not map.tiles:
        raise ValueError("the map has no lanes and no tiles to draw: give one that has")
    x_min, x_max, y_min, y_max = map.extent
    margin = 0.03 * max(x_max - x_min, y_max - y_min) + 2.0
    limits = (x_min - margin, x_max + margin, y_min - margin, y_max + margin)
    if ax is None:
        ax = _new_axes(limits)
    scale = _points_per_meter(ax, limits)
    _draw_map_lanes(ax, map, scale)
    _draw_boxes(ax, map, scale)
    _draw_tiles(ax, map)
    for route in map.routes:
        ax.plot(*route_line(map, route)[:, :2].T, color=ROUTE, linewidth=2.2, alpha=0.75, zorder=4, gid="route")
    ax.set(xlim=limits[:2], ylim=limits[2:], aspect="equal", facecolor=PAPER)
    ax.tick_params(length=0, labelsize=7, labelcolor=INK)
    ax.set_xlabel("x [m]", fontsize=7, color=INK, labelpad=1)
    ax.set_ylabel("y [m]", fontsize=7, color=INK, labelpad=1)
    ax.grid(color=GRID, linewidth=0.4, zorder=0)
    ax.set_axisbelow(True)
    if title is not None:
        ax.set_title(title, fontsize=8, color=INK, pad=4, parse_math=False)
    if legend:
        _draw_legend(ax, map)
    figure = ax.get_figure(root=True)
    if path is not None and figure is not None:
        save_figure(figure, path, dpi=dpi)
    return ax


def _new_axes(limits: tuple[float, float, float, float]) -> Axes:
    width, height = limits[1] - limits[0], limits[3] - limits[2]
    edge = _LONGEST_EDGE / max(width, height)
    figure = Figure(
        figsize=(max(edge * width, _SHORTEST_EDGE) + 0.6, max(edge * height, _SHORTEST_EDGE) + 0.8),
        layout="constrained",
    )
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def _points_per_meter(ax: Axes, limits: tuple[float, float, float, float]) -> float:
    """Scale of line widths, which are in points."""
    figure, box = ax.get_figure(root=True), ax.get_position()
    width, height = (_LONGEST_EDGE, _LONGEST_EDGE) if figure is None else figure.get_size_inches()
    return 72 * min(box.width * width / (limits[1] - limits[0]), box.height * height / (limits[3] - limits[2]))


def _draw_map_lanes(ax: Axes, map: Map, scale: float) -> None:
    states = dict(zip(map.signal_lane_ids, map.signal_states, strict=True))
    driven = [lane for lane in map.lanes if lane.lane_type not in NO_CAR_LANE_TYPES]
    others = [lane.points[:, :2] for lane in map.lanes if lane.lane_type in NO_CAR_LANE_TYPES]
    ax.add_collection(
        LineCollection(others, colors=OTHER_LANE, linewidths=max(0.4, 0.3 * scale), zorder=0.9, gid="other lanes")
    )
    lines = [lane.points[:, :2] for lane in driven]
    band = max(1.2, _LANE_WIDTH * scale)
    ax.add_collection(
        LineCollection(lines, colors=BAND, linewidths=band, capstyle="butt", joinstyle="round", zorder=1, gid="roads")
    )
    colors = [SIGNAL_COLORS[Signal(int(states.get(lane.id, Signal.UNKNOWN)))] for lane in driven]
    widths = [max(0.5, (0.2 if color == SIGNAL_COLORS[Signal.UNKNOWN] else 0.5) * scale) for color in colors]
    ax.add_collection(LineCollection(lines, colors=colors, linewidths=widths, zorder=2, gid="lanes"))
    arrows = _arrows(driven)
    ax.add_collection(
        LineCollection(arrows, colors=INK, linewidths=max(0.4, 0.2 * scale), alpha=0.7, zorder=2.1, gid="arrows")
    )
    joints = _joints(driven)
    if len(joints):
        size = min(max(0.8, 0.8 * scale), 4.0) ** 2
        ax.scatter(*joints.T, s=size, color=INK, alpha=0.6, linewidths=0, zorder=2.2, gid="connections")
    lit = ~np.isnan(map.signal_positions[:, :2]).any(-1)
    if lit.any():
        faces = [SIGNAL_COLORS[Signal(int(state))] for state in map.signal_states[lit]]
        ax.scatter(
            *map.signal_positions[lit, :2].T,
            s=16,
            facecolors=faces,
            edgecolors=INK,
            linewidths=0.6,
            zorder=3.5,
            gid="lights",
        )


def _arrows(lanes: Sequence[MapLane]) -> list[np.ndarray]:
    """Direction marks as polylines of three points; on large maps only the longest lanes get them."""
    marks: list[np.ndarray] = []
    for lane in sorted(lanes, key=lambda lane: -len(lane.points))[:_MAX_ARROWS]:
        points = lane.points[:, :2]
        arc = cumulative_length(points)
        if arc[-1] < 4.0:
            continue
        count = max(1, round(arc[-1] / _ARROW_SPACING))
        for at in (np.arange(count) + 0.5) / count * arc[-1]:
            row = min(int(np.searchsorted(arc, at, side="right")) - 1, len(arc) - 2)
            tip = np.array([np.interp(at, arc, column) for column in points.T])
            ahead = (points[row + 1] - points[row]) / max(arc[row + 1] - arc[row], 1e-9)
            side = np.array([-ahead[1], ahead[0]])
            marks.append(np.stack([tip - 1.1 * ahead + side, tip + 0.7 * ahead, tip - 1.1 * ahead - side]))
    return marks


def _joints(lanes: Sequence[MapLane]) -> np.ndarray:
    """Places where a lane that follows another one begins, [connections, 2] m."""
    starts = {lane.id: lane.points[0, :2] for lane in lanes}
    followers = {item for lane in lanes for item in lane.successors} & starts.keys()
    followers |= {lane.id for lane in lanes if not starts.keys().isdisjoint(lane.predecessors)}
    return np.array([starts[item] for item in sorted(followers)]).reshape(-1, 2)


def _draw_boxes(ax: Axes, map: Map, scale: float) -> None:
    if not map.num_agents:
        return
    types = [AgentType(int(agent_type)) for agent_type in map.agent_types]
    agents = map.agents.copy()
    typical = np.array([_SIZES[agent_type] for agent_type in types])
    agents[:, 6:8] = np.where(np.isnan(agents[:, 6:8]), typical, agents[:, 6:8])
    colors = [AGENT_COLORS[agent_type] for agent_type in types]
    rim = max(0.5, 0.1 * scale)
    ax.add_collection(
        PolyCollection(
            list(corners(agents)), facecolors=colors, edgecolors=colors, linewidths=rim, zorder=3, gid="agents"
        )
    )


def _draw_tiles(ax: Axes, map: Map) -> None:
    for number, tile in enumerate(map.tiles):
        color = STATUS_COLORS[tile.status]
        dashed = tile.status in (TileStatus.INCOMPLETE, TileStatus.MISSING)
        ax.add_collection(
            PolyCollection(
                [tile.corners],
                facecolors="none",
                edgecolors=color,
                linewidths=1.2,
                linestyles="dashed" if dashed else "solid",
                hatch="///" if tile.status == TileStatus.MISSING else None,
                zorder=4.5,
                gid=f"tile {number}",
            )
        )
        x, y = 0.9 * tile.corners[3] + 0.1 * np.array([tile.x, tile.y])  # just inside the rear left corner
        ax.text(x, y, f"{number}", fontsize=7, color=color, ha="center", va="center", zorder=5)
    lanes = map.lane_by_id
    for seam in map.seams:
        ax.plot(*zip(seam.start, seam.end, strict=True), color=SEAM, linewidth=2.6, alpha=0.8, zorder=4.6, gid="seam")
        joints = np.array([lanes[after].points[0, :2] for _, after in seam.connections]).reshape(-1, 2)
        ax.scatter(*joints.T, s=14, color=SEAM, linewidths=0, zorder=4.7)


def _draw_legend(ax: Axes, map: Map) -> None:
    statuses = {tile.status for tile in map.tiles}
    handles = [Line2D([], [], color=c, label=f"{s.value} tile") for s, c in STATUS_COLORS.items() if s in statuses]
    types = set(map.agent_types.tolist())
    marker = {"marker": "s", "linestyle": "none", "markersize": 5}
    handles += [Line2D([], [], color=c, label=t.name.lower(), **marker) for t, c in AGENT_COLORS.items() if t in types]
    if map.signal_lane_ids:
        handles.append(
            Line2D(
                [], [], color=INK, label="light", marker="o", markerfacecolor="white", linestyle="none", markersize=4
            )
        )
    handles += [Line2D([], [], color=SEAM, linewidth=2.6, label="seam")] * bool(map.seams)
    handles += [Line2D([], [], color=ROUTE, linewidth=2.2, label="route")] * bool(map.routes)
    if handles:
        ax.legend(
            handles=handles, fontsize=7, labelcolor=INK, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False
        )
