"""What stands in for an image, beside the scene that it is seen in: rays by class, cells by share, depth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from scjax.camera.raycast import CLASSES, FAR, HALF_ANGLE, look, stand_in
from scjax.scene import Scene
from scjax.viz.bev import AGENT_COLOURS, INK, plot_scene
from scjax.viz.grid import save_figure

_COLOURS = np.array([*map(to_rgb, AGENT_COLOURS.values()), to_rgb("#8f949b"), to_rgb("#c9d2b8"), to_rgb("#eef4fa")])
_CELL = 2.6  # inches


def ahead(scenes: Sequence[Scene], *, path: str | Path | None = None, dpi: int = 110) -> Figure:
    """A line a scene: from above with the field of view, every ray's class, the mean class of cells, depth of cells.

    Args:
      scenes: single NumPy scenes in the forward layout.
      path: where to write a PNG as well.

    Raises:
      ValueError: on no scenes, or one in another layout.
    """
    if not scenes:
        raise ValueError("there are no scenes to draw: give at least one")
    figure = Figure(figsize=(4 * _CELL, len(scenes) * _CELL), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(scenes), 4, squeeze=False)
    for line, scene in zip(panels, scenes, strict=True):
        view, features = look(scene), stand_in(scene)
        plot_scene(scene, ax=line[0])
        reach = FAR * np.tan(np.deg2rad(HALF_ANGLE))
        line[0].plot([FAR, 0, FAR], [reach, 0, -reach], color=INK, lw=0.6, ls="--")
        line[1].imshow(_COLOURS[view.kind], aspect="auto", interpolation="nearest")
        line[2].imshow(np.einsum("krc,kx->rcx", features.image, _COLOURS), aspect="auto", interpolation="nearest")
        line[3].imshow(features.depth * FAR, vmin=0, vmax=FAR, aspect="auto", cmap="viridis_r", interpolation="nearest")
        for panel in line[1:]:
            panel.set(xticks=[], yticks=[])
        line[0].set(xlabel="", ylabel="", xticklabels=[], yticklabels=[])
    titles = ("scene", "rays: " + ", ".join(CLASSES), "cells by share", f"depth, 0..{FAR:g} m")
    for panel, title in zip(panels[0], titles, strict=True):
        panel.set_title(title, fontsize=6, color=INK)
    if path is not None:
        save_figure(figure, path, dpi=dpi)
    return figure
