"""Many scenes in one figure, and atomic figure files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scjax.scene import Scene
from scjax.scene.files import whole_file
from scjax.scene.per_type import PerType
from scjax.viz.bev import LEGEND, legend_handles, plot_scene

_CELL = 2.6  # inches
_LEGEND_ENTRY = 0.86  # inches, of the longest names


def grid(
    scenes: Scene | Sequence[Scene],
    *,
    columns: int | None = None,
    titles: Sequence[str] | None = None,
    known: PerType | Sequence[PerType] | None = None,
    speeds: bool = False,
    path: str | Path | None = None,
    dpi: int = 130,
) -> Figure:
    """Scenes side by side, row by row, in the colors of ``plot_scene`` with one legend.

    Args:
      scenes: a batch [n], or single scenes.
      columns: scenes per row; None: about a square.
      titles: one per scene, with one or more lines.
      known: as in ``plot_scene``: one pair of masks per scene, or a batch of them.
      speeds: as in ``plot_scene``.
      path: PNG or SVG file to write as well (``save_figure``).
      dpi: resolution of that file.

    Returns:
      The figure.

    Raises:
      ValueError: on no scenes, or if the number of titles or masks differs from the number of scenes.
    """
    if isinstance(scenes, Scene):
        if len(scenes.batch_shape) > 1:
            raise ValueError(f"grid draws a batch [n] or a list of scenes, this is {scenes.batch_shape}: flatten it")
        host = scenes.to_numpy()
        scenes = [host[i] for i in range(host.batch_shape[0])] if host.batch_shape else [host]
    if isinstance(known, PerType):
        known = [PerType(agents=known.agents[i], lanes=known.lanes[i]) for i in range(len(known.agents))]
    if not scenes:
        raise ValueError("there are no scenes to draw: give at least one")
    for name, items in (("titles", titles), ("known", known)):
        if items is not None and len(items) != len(scenes):
            raise ValueError(f"{len(items)} {name} for {len(scenes)} scenes: give one each, or None")
    columns = columns or math.ceil(math.sqrt(len(scenes)))
    rows = math.ceil(len(scenes) / columns)
    title_height = (
        0.2 * max((title.count("\n") + 1 for title in titles), default=0) if titles is not None else 0.0
    )  # inches
    handles = legend_handles(scenes)
    legend_columns = max(min(len(handles), int(columns * _CELL / _LEGEND_ENTRY)), 1)
    legend_height = 0.12 + 0.18 * math.ceil(len(handles) / legend_columns)
    figure = Figure(figsize=(columns * _CELL, rows * (_CELL + title_height) + legend_height), facecolor="white")
    FigureCanvasAgg(figure)
    width, height = figure.get_size_inches()
    margin = 0.04
    for k, scene in enumerate(scenes):
        left, top = (
            (k % columns) * _CELL + margin,
            height - (k // columns) * (_CELL + title_height) - title_height - margin,
        )
        edge = _CELL - 2 * margin
        ax = figure.add_axes((left / width, (top - edge) / height, edge / width, edge / height))
        plot_scene(
            scene,
            ax=ax,
            title=None if titles is None else titles[k],
            known=None if known is None else known[k],
            speeds=speeds,
        )
        ax.set(xlabel="", ylabel="", xticklabels=[], yticklabels=[])
    _legend(figure, handles, legend_columns)
    if path is not None:
        save_figure(figure, path, dpi=dpi)
    return figure


def save_figure(figure: Figure, path: str | Path, *, dpi: int = 130) -> None:
    """Writes a PNG, or an SVG if ``path`` ends in .svg. The file appears complete or not at all."""
    path = Path(path)
    with whole_file(path) as file:
        figure.savefig(file, dpi=dpi, format="svg" if path.suffix == ".svg" else "png")


def _legend(figure: Figure, handles: Sequence[Any], columns: int) -> None:
    anchor = (0.5, -0.02 / figure.get_size_inches()[1])
    figure.legend(handles=handles, loc="lower center", ncols=columns, bbox_to_anchor=anchor, **LEGEND)
