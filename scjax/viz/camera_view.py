"""Ray-cast camera views next to their scenes: class of every ray, class shares of image cells, depth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from scjax.camera.raycast import CLASSES, HALF_ANGLE, MAX_DEPTH, cast_rays, render
from scjax.scene import Scene
from scjax.viz.bev import AGENT_COLORS, INK, plot_scene
from scjax.viz.grid import save_figure

_COLORS = np.array([*map(to_rgb, AGENT_COLORS.values()), to_rgb("#8f949b"), to_rgb("#c9d2b8"), to_rgb("#eef4fa")])
_CELL = 2.6  # inches


def camera_view_grid(scenes: Sequence[Scene], *, path: str | Path | None = None, dpi: int = 110) -> Figure:
    """One row per scene: bird's-eye view with the field of view, ray classes, class shares of cells, depth of cells.

    Args:
      scenes: single NumPy scenes with ``Crop.FORWARD``.
      path: PNG or SVG file to write as well.
      dpi: resolution of that file.

    Returns:
      The figure.

    Raises:
      ValueError: on no scenes, or a scene with another crop.
    """
    if not scenes:
        raise ValueError("there are no scenes to draw: give at least one")
    figure = Figure(figsize=(4 * _CELL, len(scenes) * _CELL), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(scenes), 4, squeeze=False)
    for row, scene in zip(panels, scenes, strict=True):
        hits, features = cast_rays(scene), render(scene)
        plot_scene(scene, ax=row[0])
        reach = MAX_DEPTH * np.tan(np.deg2rad(HALF_ANGLE))
        row[0].plot([MAX_DEPTH, 0, MAX_DEPTH], [reach, 0, -reach], color=INK, lw=0.6, ls="--")
        row[1].imshow(_COLORS[hits.classes], aspect="auto", interpolation="nearest")
        row[2].imshow(np.einsum("krc,kx->rcx", features.image, _COLORS), aspect="auto", interpolation="nearest")
        depth = features.depth * MAX_DEPTH
        row[3].imshow(depth, vmin=0, vmax=MAX_DEPTH, aspect="auto", cmap="viridis_r", interpolation="nearest")
        for panel in row[1:]:
            panel.set(xticks=[], yticks=[])
        row[0].set(xlabel="", ylabel="", xticklabels=[], yticklabels=[])
    titles = ("scene", "rays: " + ", ".join(CLASSES), "cells by share", f"depth, 0..{MAX_DEPTH:g} m")
    for panel, title in zip(panels[0], titles, strict=True):
        panel.set_title(title, fontsize=6, color=INK)
    if path is not None:
        save_figure(figure, path, dpi=dpi)
    return figure
