"""Pictures of a report: distributions, methods side by side, and galleries of best, median and worst scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from scjax.evaluate.population import Population
from scjax.metrics.distributions import VEHICLE
from scjax.metrics.scene_stats import SceneStats

RANKINGS = {"M": 1, "connection_gap_m": -1, "vehicles_on_lane": 1, "vehicle_overlap_pairs": -1}
"""Value of single scenes that a gallery is ranked by -> 1 if higher is better, -1 if lower is better."""

MAX_METHODS = 4  # in pictures that compare methods


def draw_pictures(
    folder: Path,
    real: SceneStats,
    stats: Mapping[str, SceneStats],
    methods: Mapping[str, Population],
    *,
    side_by_side: int,
    gallery: int,
) -> dict[str, Path]:
    """Draws all pictures of a report; caption -> file.

    Args:
      real, stats: of the references and of each method.
      side_by_side: number of references that are shown side by side with the methods.
      gallery: number of best, median and worst scenes in a gallery of the first method.
    """
    folder.mkdir(exist_ok=True)
    pictures = {"Distributions of vehicles": folder / "distributions.png"}
    first_stats = {name: stats[name] for name in list(stats)[:MAX_METHODS]}
    plot_distributions(real, first_stats, pictures["Distributions of vehicles"])
    answering = [population for population in methods.values() if population.references is not None][:MAX_METHODS]
    if answering:
        pictures["Side by side"] = folder / "side-by-side.png"
        plot_side_by_side(answering, side_by_side, pictures["Side by side"])
    name = next(iter(methods))
    for value in RANKINGS:
        path = folder / f"gallery-{value}.png"
        if plot_gallery(methods[name], stats[name], value, gallery, path):
            pictures[f"{name}: best, median and worst by {value.replace('_', ' ')}"] = path
    return pictures


def plot_distributions(real: SceneStats, stats: Mapping[str, SceneStats], path: Path) -> None:
    """Histograms of the vehicles' quantities: real scenes filled, methods as lines."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 6.5), layout="constrained")
    axes = figure.subplots(2, 3)
    for axis, (name, quantity) in zip(axes.flat, VEHICLE.items(), strict=True):
        for label, one in {"real": real, **stats}.items():
            counts = one.cluster_sums.total.get(f"strict/{name}", np.zeros(0))
            if not counts.sum():
                continue
            edges = quantity.low + quantity.width * np.arange(len(counts) + 1)
            share = counts / counts.sum()
            last = np.flatnonzero(share > 1e-4).max() + 2
            options = {"fill": True, "alpha": 0.25, "color": "0.4"} if label == "real" else {"linewidth": 1.3}
            axis.stairs(share[:last], edges[: last + 1], label=label, **options)
        axis.set_title(name.replace("_", " "), parse_math=False)
        axis.spines[["top", "right"]].set_visible(False)
    axes.flat[0].legend(frameon=False, fontsize=8)
    FigureCanvasAgg(figure).print_png(str(path))


def plot_side_by_side(populations: Sequence[Population], count: int, path: Path) -> None:
    """``count`` references, evenly spaced, each beside the answers of all populations."""
    from scjax.viz import grid

    first, *_ = populations
    rows = sorted({round(row) for row in np.linspace(0, len(first) - 1, min(len(first), count))})
    scenes, titles = [], []
    for row in rows:
        assert first.references is not None
        scenes += first.references.read([int(first.rows[row])])
        titles.append(f"reference {int(first.rows[row])}")
        for population in populations:
            scenes += population.source.read([row])
            titles.append(population.name)
    columns = 1 + len(populations)
    grid(scenes, columns=columns * (2 if columns < 5 else 1), titles=titles, path=path)


def plot_gallery(population: Population, stats: SceneStats, value: str, count: int, path: Path) -> bool:
    """The ``count`` best, median and worst scenes by a value of ``RANKINGS``, beside their references.

    Returns:
      False if no scene has the value; nothing is drawn then.
    """
    from scjax.viz import grid

    scores = RANKINGS[value] * stats.per_scene.get(value, np.zeros(0))
    rows = np.flatnonzero(np.isfinite(scores))
    if not len(rows):
        return False
    order = rows[np.argsort(-scores[rows], kind="stable")]
    middle = max((len(order) - count) // 2, 0)
    selections = {"best": order[:count], "median": order[middle : middle + count], "worst": order[::-1][:count]}
    scenes, titles = [], []
    for rank, selection in selections.items():
        for row, scene in zip(selection, population.source.read(selection.tolist()), strict=True):
            if population.references is not None:
                scenes += population.references.read([int(population.rows[row])])
                titles.append(f"reference {int(population.rows[row])}")
            scenes.append(scene)
            titles.append(f"{rank}: {RANKINGS[value] * scores[row]:.3g}")
    grid(scenes, columns=2 * count if population.references is not None else count, titles=titles, path=path)
    return True
