"""Picture of an ablation: a row of panels per modality, a panel per metric."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.studies.ablation.judge import HEADLINE, METRICS
from experiments.studies.page import new_figure

_SHOWN = ("prompt", "control", "loss", "lane CCS", "agent CCS", "lane CSC", "agent CSC", "vehicles_overlapping")
_OWN, _SHUFFLED, _NONE = "#26547c", "#c98b2b", "0.6"


def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Dots: own conditions; rings: shuffled conditions; bars: intervals over seeds; gray: no condition.

    Args:
      rows: from ``report.summary``.
    """
    modalities = list(dict.fromkeys(row["modality"] for row in rows))
    shown = {
        modality: [name for name in _SHOWN if any(_finite(row, modality, name) for row in rows)] or [HEADLINE[modality]]
        for modality in modalities
    }
    height = sum(1.0 + 0.22 * sum(row["modality"] == modality for row in rows) for modality in modalities)
    columns = max(map(len, shown.values()))
    figure = new_figure(2.2 + 1.9 * columns, height)
    panels = figure.subplots(len(modalities), columns, squeeze=False, sharey="row")
    for line, modality in zip(panels, modalities, strict=True):
        mine = [row for row in rows if row["modality"] == modality]
        for panel, name in zip(line, shown[modality], strict=False):
            for which, offset, style in (
                ("own", 0.12, {"color": _OWN, "fmt": "o"}),
                ("shuffled", -0.12, {"color": _SHUFFLED, "fmt": "o", "mfc": "white"}),
            ):
                spreads = [row["metrics"][name][which] for row in mine]
                half = [spread.half if math.isfinite(spread.half) else 0 for spread in spreads]
                place = np.arange(len(mine)) - offset
                panel.errorbar([spread.mean for spread in spreads], place, xerr=half, ms=3.5, lw=0.8, ls="", **style)
            for row in mine:
                if row["entry"] == "none":
                    panel.axvline(row["metrics"][name]["own"].mean, color=_NONE, lw=0.7, zorder=0)
            panel.set_title(f"{name} {'→' if METRICS[name].more_is_better else '←'} better", fontsize=7)
            panel.tick_params(labelsize=6)
            panel.grid(axis="y", alpha=0.3, lw=0.4)
        for panel in line[len(shown[modality]) :]:
            panel.set_axis_off()
        line[0].set_yticks(range(len(mine)), [row["title"] for row in mine], fontsize=6)
        line[0].set_ylim(len(mine) - 0.5, -0.5)
        line[0].set_ylabel(f"on {modality}s", fontsize=8)
    return figure


def _finite(row: dict[str, Any], modality: str, name: str) -> bool:
    return row["modality"] == modality and math.isfinite(row["metrics"][name]["own"].mean)
