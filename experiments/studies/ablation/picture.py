"""Every row of an ablation in one plot: a line of panels a kind, a panel a metric."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from experiments.studies.ablation.judge import HEADLINE, METRICS
from scjax.viz.grid import save_figure

_SHOWN = ("prompt", "control", "loss", "lane CCS", "agent CCS", "lane CSC", "agent CSC", "vehicles_overlapping")
_OWN, _OTHER, _NONE = "#26547c", "#c98b2b", "0.6"


def draw(rows: Sequence[dict[str, Any]], path: Path) -> Figure:
    """Dots: with a scene's own condition; rings: with another's; bars: intervals over seeds; grey: no condition.

    Args:
      rows: of ``report.summary``.
    """
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    shown = {
        kind: [name for name in _SHOWN if any(_finite(row, kind, name) for row in rows)] or [HEADLINE[kind]]
        for kind in kinds
    }
    height = sum(1.0 + 0.22 * sum(row["kind"] == kind for row in rows) for kind in kinds)
    columns = max(map(len, shown.values()))
    figure = Figure(figsize=(2.2 + 1.9 * columns, height), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(kinds), columns, squeeze=False, sharey="row")
    for line, kind in zip(panels, kinds, strict=True):
        mine = [row for row in rows if row["kind"] == kind]
        for panel, name in zip(line, shown[kind], strict=False):
            for which, offset, style in (
                ("own", 0.12, {"color": _OWN, "fmt": "o"}),
                ("shuffled", -0.12, {"color": _OTHER, "fmt": "o", "mfc": "white"}),
            ):
                found = [row["metrics"][name][which] for row in mine]
                half = [spread.half if math.isfinite(spread.half) else 0 for spread in found]
                place = np.arange(len(mine)) - offset
                panel.errorbar([spread.mean for spread in found], place, xerr=half, ms=3.5, lw=0.8, ls="", **style)
            for row in mine:
                if row["entry"] == "none":
                    panel.axvline(row["metrics"][name]["own"].mean, color=_NONE, lw=0.7, zorder=0)
            panel.set_title(f"{name} {'→' if METRICS[name][1] else '←'} better", fontsize=7)
            panel.tick_params(labelsize=6)
            panel.grid(axis="y", alpha=0.3, lw=0.4)
        for panel in line[len(shown[kind]) :]:
            panel.set_axis_off()
        line[0].set_yticks(range(len(mine)), [row["title"] for row in mine], fontsize=6)
        line[0].set_ylim(len(mine) - 0.5, -0.5)
        line[0].set_ylabel(f"on {kind}s", fontsize=8)
    save_figure(figure, path, dpi=120)
    return figure


def _finite(row: dict[str, Any], kind: str, name: str) -> bool:
    return row["kind"] == kind and math.isfinite(row["metrics"][name]["own"].mean)
