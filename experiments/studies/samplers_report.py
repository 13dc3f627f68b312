"""Report of the samplers study: metrics that a setting worsens, the cheapest setting that worsens none, table, picture.

A metric is worse if its difference from the reference, paired by location, is larger than chance makes the largest of
all metrics' differences in 95 of 100 sweeps (in units of each difference's deviation; the single step of Westfall &
Young 1993). Judged one by one at 95 %, sixteen metrics would often find the reference itself worse in one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.studies.page import new_figure, table_lines

Row = dict[str, Any]


class Metric(NamedTuple):
    """Title of a metric, and whether more is better."""

    title: str
    more_is_better: bool


METRICS = {
    "frechet_connectivity": Metric("connectivity of the lane graph", False),
    "frechet_density": Metric("density of the lane graph", False),
    "frechet_reach": Metric("reach in the lane graph", False),
    "frechet_convenience": Metric("convenience of the lane graph", False),
    "connection_gap_m": Metric("connection gap [m]", False),
    "open_connections": Metric("connections open by more than 1 m", False),
    "nearest_dist_jsd": Metric("distance to the next vehicle", False),
    "lat_dev_jsd": Metric("vehicles off the centerline", False),
    "ang_dev_jsd": Metric("vehicles off the lane's heading", False),
    "speed_jsd": Metric("speeds", False),
    "length_jsd": Metric("lengths of vehicles", False),
    "width_jsd": Metric("widths of vehicles", False),
    "vehicles_on_lane": Metric("vehicles within 1.5 m of a lane", True),
    "off_heading": Metric("vehicles across their lane", False),
    "vehicles_overlapping": Metric("vehicles that overlap", False),
    "prompt": Metric("what the prompt asks for", True),
}
_COLUMNS = 4
_ROUNDING = 1e-9  # relative deviation that is rounding alone


def worse_metrics(row: Row, reference: Row, *, level: float = 0.95) -> list[str] | None:
    """Metrics in which a row is significantly worse than the reference; None without bootstrap samples.

    By chance alone, any metric is found in 1 - ``level`` of all sweeps. NaN is worse than any value of the reference.
    """
    if not reference["bootstrap"] or not row["bootstrap"]:
        return None
    sign = {name: -1.0 if metric.more_is_better else 1.0 for name, metric in METRICS.items()}
    worse, scaled_differences, null_samples = set[str](), {}, []
    for name in METRICS:
        value, reference_value = row["metrics"][name]["value"], reference["metrics"][name]["value"]
        if not math.isfinite(reference_value):
            continue
        if not math.isfinite(value):
            worse.add(name)
            continue
        samples = sign[name] * np.subtract(row["bootstrap"][name], reference["bootstrap"][name])
        samples = np.where(np.isfinite(samples), samples, np.nanmean(samples))
        deviation, difference = samples.std(), sign[name] * (value - reference_value)
        if deviation > _ROUNDING * max(abs(reference_value), _ROUNDING):
            scaled_differences[name] = difference / deviation
            null_samples.append((samples - samples.mean()) / deviation)
        elif difference > _ROUNDING * abs(reference_value):
            worse.add(name)
    if null_samples:
        largest = np.quantile(np.max(null_samples, axis=0), level)
        worse |= {name for name, difference in scaled_differences.items() if difference > largest}
    return [name for name in METRICS if name in worse]


def verdict(rows: Sequence[Row], reference: Row) -> str:
    """The setting with the fewest evaluations that worsens no metric, or the one that worsens fewest.

    A setting also answers for metrics that its series worsens with more evaluations: among many settings, some pass by
    chance. If there are repeats of the reference, the verdict says how many metrics they worsen.
    """
    settings = [row for row in rows if row is not reference and not row.get("repeat")]
    worse = [(row, names) for row in settings if (names := worse_metrics(row, reference)) is not None]
    judged = [
        (row, [name for name in METRICS if any(name in names for other, names in worse if _at_least(other, row))])
        for row, _ in worse
    ]
    repeats = [len(worse_metrics(row, reference) or []) for row in rows if row.get("repeat")]
    counts = ", ".join(map(str, repeats))
    chance = (
        f" With other random numbers {reference['name']} is worse in {counts} of {len(METRICS)}." if repeats else ""
    )
    if not judged:
        return "Nothing to compare: it takes held-out scenes of two locations or more, and a second setting."
    row, names = min(judged, key=lambda pair: (bool(pair[1]), len(pair[1]), pair[0]["evaluations"], pair[0]["seconds"]))
    cost = (
        f"{row['evaluations']} evaluations of the network and {row['seconds']:.3g} s per scene, "
        f"against {reference['evaluations']} and {reference['seconds']:.3g} s"
    )
    if not names:
        return (
            f"Fewest steps without a significant difference from {reference['name']}: {row['name']} ({cost}).{chance}"
        )
    titles = ", ".join(METRICS[name].title for name in names)
    return (
        f"All settings differ significantly from {reference['name']}; nearest is {row['name']} ({cost}), "
        f"worse in {titles}.{chance}"
    )


def _at_least(row: Row, start: Row) -> bool:
    """Whether a row is of the same series with at least as many evaluations."""
    return row["series"] == start["series"] and row["evaluations"] >= start["evaluations"]


def markdown(rows: Sequence[Row], reference: Row, command: str, conclusion: str) -> str:
    """The page: the verdict, and a line per setting with its cost and the metrics it worsens."""
    cells = []
    for row in rows:
        names = worse_metrics(row, reference)
        titles = ", ".join(METRICS[name].title for name in names or ()) or "no significant difference"
        worse = "no intervals" if names is None else titles
        cells.append([row["name"], str(row["evaluations"]), f"{row['seconds']:.3g}", worse])
    lines = ["# Samplers and steps", "", f"`{command}`", "", conclusion, ""]
    lines += table_lines(["setting", "evaluations", "s per scene", f"worse than {reference['name']} in"], cells)
    return "\n".join(lines) + "\n"


def draw(rows: Sequence[Row], reference: Row) -> Figure:
    """A panel per metric over network evaluations, a line per series; gray: the interval of the reference."""
    shown = [name for name in METRICS if any(math.isfinite(row["metrics"][name]["value"]) for row in rows)]
    count = len(shown) + 1
    lines = math.ceil(count / _COLUMNS)
    figure = new_figure(3.4 * _COLUMNS, 2.5 * lines)
    panels = figure.subplots(lines, _COLUMNS, squeeze=False).ravel()
    series: dict[str, list[Row]] = {}
    for row in sorted((row for row in rows if not row.get("repeat")), key=lambda row: row["evaluations"]):
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
        panel.set_title(METRICS[metric].title, fontsize=9)
    panels[count - 1].set_title("seconds per scene", fontsize=9)
    for panel in panels[:count]:
        panel.set_xscale("log")
        panel.tick_params(labelsize=7)
        panel.grid(alpha=0.3, lw=0.4)
    for panel in panels[count:]:
        panel.set_axis_off()
    panels[0].legend(fontsize=7)
    figure.supxlabel("evaluations of the network", fontsize=9)
    return figure
