"""Pictures of a report: distributions of real against generated scenes, and the best, middling and worst scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from scjax.evaluate.population import Population
from scjax.metrics.distributions import VEHICLE
from scjax.metrics.scene_stats import SceneStats

BETTER = {"M": 1, "connection_gap_m": -1, "vehicles_on_lane": 1, "vehicle_overlap_pairs": -1}
"""Values of single scenes that galleries are sorted by, and whether more (1) or less (-1) is better."""

SPREAD = 12  # references in a picture side by side
EACH = 4  # scenes of each kind in a gallery


def distributions(real: SceneStats, measured: Mapping[str, SceneStats], path: Path) -> None:
    """Histograms of the vehicles' quantities, real filled, populations as lines."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 6.5), layout="constrained")
    axes = figure.subplots(2, 3)
    for axis, (name, quantity) in zip(axes.flat, VEHICLE.items(), strict=True):
        for label, one in {"real": real, **measured}.items():
            counts = one.cluster_sums.total.get(f"strict/{name}", np.zeros(0))
            if not counts.sum():
                continue
            edges = quantity.low + quantity.width * np.arange(len(counts) + 1)
            share = counts / counts.sum()
            last = np.flatnonzero(share > 1e-4).max() + 2
            options = {"fill": True, "alpha": 0.25, "color": "0.4"} if label == "real" else {"linewidth": 1.3}
            axis.stairs(share[:last], edges[: last + 1], label=label, **options)
        axis.set_title(name.replace("_", " "))
        axis.spines[["top", "right"]].set_visible(False)
    axes.flat[0].legend(frameon=False, fontsize=8)
    FigureCanvasAgg(figure).print_png(str(path))


def side_by_side(populations: Sequence[Population], path: Path) -> None:
    """References spread over the first population, and what every population that answers them has: unsorted."""
    from scjax.viz import grid

    first, *_ = populations
    rows = sorted({round(row) for row in np.linspace(0, len(first) - 1, min(len(first), SPREAD))})
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


def gallery(population: Population, measured: SceneStats, value: str, path: Path) -> bool:
    """The best, the median and the worst scenes by a value, beside their references; False without any value."""
    from scjax.viz import grid

    column = BETTER[value] * measured.per_scene.get(value, np.zeros(0))
    rows = np.flatnonzero(np.isfinite(column))
    if not len(rows):
        return False
    order = rows[np.argsort(-column[rows], kind="stable")]
    middle = max((len(order) - EACH) // 2, 0)
    chosen = {"best": order[:EACH], "median": order[middle : middle + EACH], "worst": order[::-1][:EACH]}
    scenes, titles = [], []
    for kind, few in chosen.items():
        made = population.source.read(few.tolist())
        for row, scene in zip(few, made, strict=True):
            if population.references is not None:
                (reference,) = population.references.read([int(population.rows[row])])
                scenes.append(reference)
                titles.append(f"reference {int(population.rows[row])}")
            scenes.append(scene)
            titles.append(f"{kind}: {BETTER[value] * column[row]:.3g}")
    grid(scenes, columns=2 * EACH if population.references is not None else EACH, titles=titles, path=path)
    return True
