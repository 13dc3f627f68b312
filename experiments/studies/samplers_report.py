"""What a sweep of samplers says: which metrics a setting worsens, the cheapest that worsens none, table and picture.

A metric is worse where the setting can be told from the reference by it: the difference, paired by location, lies
beyond what chance makes of the largest of all metrics' differences in 95 of 100 sweeps (in units of each difference's
deviation; the single step of Westfall & Young 1993). Judged one by one at 95 %, sixteen metrics would find the
reference itself worse in one, now and then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scjax.viz.grid import save_figure

Row = dict[str, Any]

# Name -> title, and whether more is better.
METRICS = {
    "frechet_connectivity": ("connectivity of the lane graph", False),
    "frechet_density": ("density of the lane graph", False),
    "frechet_reach": ("reach in the lane graph", False),
    "frechet_convenience": ("convenience of the lane graph", False),
    "connection_gap_m": ("gap at joints [m]", False),
    "open_connections": ("joints open by more than 1 m", False),
    "nearest_dist_jsd": ("distance to the next vehicle", False),
    "lat_dev_jsd": ("vehicles off the centreline", False),
    "ang_dev_jsd": ("vehicles off the lane's heading", False),
    "speed_jsd": ("speeds", False),
    "length_jsd": ("lengths of vehicles", False),
    "width_jsd": ("widths of vehicles", False),
    "vehicles_on_lane": ("vehicles within 1.5 m of a lane", True),
    "off_heading": ("vehicles across their lane", False),
    "vehicles_overlapping": ("vehicles that overlap", False),
    "prompt": ("what the prompt asks for", True),
}
_COLUMNS = 4
_STILL = 1e-9  # of a value: a deviation of rounding alone


def worse(row: Row, reference: Row, *, level: float = 0.95) -> list[str] | None:
    """Metrics in which a row can be told to be worse than the reference; None where nothing was drawn.

    Of chance alone, any is found in 1 - ``level`` of all sweeps. A value that is NaN where the reference has one is
    worse than any number.
    """
    if not reference["drawn"] or not row["drawn"]:
        return None
    sign = {name: -1.0 if more else 1.0 for name, (_, more) in METRICS.items()}
    found, apart, chance = set[str](), {}, []
    for name in METRICS:
        ours, theirs = row["metrics"][name]["value"], reference["metrics"][name]["value"]
        if not math.isfinite(theirs):
            continue
        if not math.isfinite(ours):
            found.add(name)
            continue
        drawn = sign[name] * np.subtract(row["drawn"][name], reference["drawn"][name])
        drawn = np.where(np.isfinite(drawn), drawn, np.nanmean(drawn))
        deviation, off = drawn.std(), sign[name] * (ours - theirs)
        if deviation > _STILL * max(abs(theirs), _STILL):
            apart[name] = off / deviation
            chance.append((drawn - drawn.mean()) / deviation)
        elif off > _STILL * abs(theirs):
            found.add(name)
    if chance:
        largest = np.quantile(np.max(chance, axis=0), level)
        found |= {name for name, off in apart.items() if off > largest}
    return [name for name in METRICS if name in found]


def verdict(rows: Sequence[Row], reference: Row) -> str:
    """The setting with the fewest evaluations that worsens nothing, or the one that worsens least; and how many metrics
    the reference worsens from other noise.

    A setting also answers for what its series worsens with more evaluations: of many settings one is inside by chance.
    """
    found = [(row, worse(row, reference)) for row in rows if row is not reference and not row.get("again")]
    others = [(row, bad) for row, bad in found if bad is not None]
    judged = [
        (row, [name for name in METRICS if any(name in bad for more, bad in others if _onwards(more, row))])
        for row, _ in others
    ]
    anew = [len(worse(row, reference) or []) for row in rows if row.get("again")]
    chance = f" By chance alone {reference['name']} is worse in {', '.join(map(str, anew))}." if anew else ""
    if not judged:
        return "Nothing to compare: it takes held-back scenes of two locations or more, and a second setting."
    row, bad = min(judged, key=lambda pair: (bool(pair[1]), len(pair[1]), pair[0]["evaluations"], pair[0]["seconds"]))
    cost = (
        f"{row['evaluations']} evaluations of the network and {row['seconds']:.3g} s a scene, "
        f"against {reference['evaluations']} and {reference['seconds']:.3g} s"
    )
    if not bad:
        return f"Fewest steps that are not told from {reference['name']}: {row['name']} ({cost}).{chance}"
    titles = ", ".join(METRICS[name][0] for name in bad)
    nothing = f"All are told from {reference['name']}; nearest is {row['name']} ({cost})"
    return f"{nothing}, worse in {titles}.{chance}"


def _onwards(row: Row, start: Row) -> bool:
    return row["series"] == start["series"] and row["evaluations"] >= start["evaluations"]


def markdown(rows: Sequence[Row], reference: Row) -> str:
    """A line a row: cost, and in what it is told to be worse than the reference."""
    lines = ["| setting | evaluations | s a scene | worse in |", "|---|---|---|---|"]
    for row in rows:
        bad = worse(row, reference)
        told = "no intervals" if bad is None else ", ".join(METRICS[name][0] for name in bad) or "nothing"
        lines.append(f"| {row['name']} | {row['evaluations']} | {row['seconds']:.3g} | {told} |")
    return "\n".join(lines) + "\n"


def draw(rows: Sequence[Row], reference: Row, path: Path) -> Figure:
    """A panel a metric over evaluations of the network, a line a series; grey: the reference's interval."""
    shown = [name for name in METRICS if any(math.isfinite(row["metrics"][name]["value"]) for row in rows)]
    count = len(shown) + 1
    lines = math.ceil(count / _COLUMNS)
    figure = Figure(figsize=(3.4 * _COLUMNS, 2.5 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(lines, _COLUMNS, squeeze=False).ravel()
    series: dict[str, list[Row]] = {}
    for row in sorted((row for row in rows if not row.get("again")), key=lambda row: row["evaluations"]):
        series.setdefault(row["series"], []).append(row)
    for name, each in series.items():
        x = [row["evaluations"] for row in each]
        for panel, metric in zip(panels, shown, strict=False):
            value, low, high = ([row["metrics"][metric][part] for row in each] for part in ("value", "low", "high"))
            off = np.maximum([np.subtract(value, low), np.subtract(high, value)], 0)
            panel.errorbar(x, value, yerr=off, marker=".", lw=1, elinewidth=0.5, label=name)
        panels[count - 1].plot(x, [row["seconds"] for row in each], ".-", lw=1, label=name)
    for panel, metric in zip(panels, shown, strict=False):
        bounds = reference["metrics"][metric]
        if math.isfinite(bounds["low"]) and math.isfinite(bounds["high"]):
            panel.axhspan(bounds["low"], bounds["high"], color="0.85", zorder=0)
        panel.set_title(METRICS[metric][0], fontsize=9)
    panels[count - 1].set_title("seconds a scene", fontsize=9)
    for panel in panels[:count]:
        panel.set_xscale("log")
        panel.tick_params(labelsize=7)
        panel.grid(alpha=0.3, lw=0.4)
    for panel in panels[count:]:
        panel.set_axis_off()
    panels[0].legend(fontsize=7)
    figure.supxlabel("evaluations of the network", fontsize=9)
    save_figure(figure, path, dpi=100)
    return figure
