"""How similar are synthetic scenes to real ones? Distances of distributions, beside the floor of the real scenes.

    python -m experiments.studies.synthetic_vs_real records:runs/synthetic#val tiles:eval/tiles_real_train.npz \\
        --out=docs/results/synthetic_vs_real

The floor is the distance between two halves of the reference with different locations. SCENES and REFERENCE are sources
as in scjax evaluate: records:FOLDER#SPLIT, npz:FOLDER, tiles:FILE#main. Several SCENES count in equal parts.

Writes OUT.md (a table), OUT.json and OUT.png (histograms).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.studies.page import command_line, new_figure, script_parser, table_lines, write_page
from scjax.evaluate.sources import SceneSource, open_source
from scjax.metrics.cluster_sums import ClusterSums
from scjax.metrics.distances import histogram, jensen_shannon
from scjax.metrics.distributions import GRAPH, Sums, scene_sums, table
from scjax.metrics.realism import lane_offsets, scene_realism
from scjax.scene import AgentType, Scene, Signal


class Histogram(NamedTuple):
    """Title, range and bin width of a histogram."""

    title: str
    low: float
    high: float
    width: float


HISTOGRAMS = {
    "lanes": Histogram("lanes per scene", 0.0, 80.0, 4.0),
    "agents": Histogram("agents per scene", 0.0, 61.0, 2.0),
    "vehicles": Histogram("vehicles per scene", 0.0, 61.0, 2.0),
    "pedestrians": Histogram("pedestrians per scene", 0.0, 20.0, 1.0),
    "cyclists": Histogram("cyclists per scene", 0.0, 6.0, 1.0),
    "vehicle_speed": Histogram("speed of other vehicles [m/s]", 0.0, 35.0, 1.0),
    "ego_speed": Histogram("speed of the ego [m/s]", 0.0, 35.0, 2.0),
    "pedestrian_speed": Histogram("speed of pedestrians [m/s]", 0.0, 4.0, 0.25),
    "vehicle_length": Histogram("length of vehicles [m]", 3.0, 14.0, 0.2),
    "vehicle_width": Histogram("width of vehicles [m]", 1.4, 3.4, 0.1),
    "lane_length": Histogram("length of lanes [m]", 0.0, 70.0, 2.5),
    "lane_turn": Histogram("turn of lanes [degrees]", 0.0, 180.0, 7.5),
    "heading": Histogram("heading of other vehicles [degrees]", 0.0, 180.0, 7.5),
    "lane_offset": Histogram("distance of vehicles from their lane [m]", 0.0, 2.5, 0.125),
}
SHARES = {
    "vehicles_on_lane": "vehicles within 1.5 m of a lane",
    "scenes_vehicle_overlap": "scenes with overlapping vehicles",
    "off_heading": "vehicles across their lane",
    "with_pedestrians": "scenes with pedestrians",
    "with_cyclists": "scenes with cyclists",
    "with_signals": "scenes with signals",
}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.synthetic_vs_real", __doc__)
    parser.add_argument("scenes", metavar="SCENES", nargs="+", help="sources of the scenes to judge, taken together")
    parser.add_argument("reference", metavar="REFERENCE", help="source of real scenes")
    add = parser.add_argument
    add("--out", type=Path, default=Path("synthetic_vs_real"), help="path without ending (default %(default)s)")
    add("--limit", type=int, default=2000, metavar="N", help="scenes per side at most (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        ours, reference = (
            cluster_sums_of([open_source(text) for text in side], args.limit)
            for side in (args.scenes, [args.reference])
        )
        comparison = compare(ours, reference)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.synthetic_vs_real: {error}")
    text = markdown(comparison, command_line("synthetic_vs_real", arguments))
    write_page(args.out, text, comparison._asdict(), draw(ours.total, reference.total))
    print(text)


class Comparison(NamedTuple):
    """Quantity -> (mean here and of the reference or None, distance, floor); share -> (here, reference)."""

    quantities: dict[str, tuple[float | None, float | None, float, float]]
    shares: dict[str, tuple[float, float]]


def cluster_sums_of(sources: Sequence[SceneSource], limit: int) -> ClusterSums:
    """Sums of at most ``limit`` evenly spaced scenes, as many of each source."""
    cluster_sums = ClusterSums()
    for source in sources:
        clusters = source.clusters
        count = min(max(limit // len(sources), 1), len(clusters))
        rows = np.unique(np.linspace(0, len(clusters) - 1, count).astype(int))
        for row in tqdm(rows, "scenes", disable=None):
            cluster_sums.add(sums_of(source.read([int(row)])[0]), clusters[row])
    return cluster_sums


def sums_of(scene: Scene) -> Sums:
    """The contribution of one scene to histograms, shares and graph quantities."""
    types, agents = np.asarray(scene.agent_types), np.asarray(scene.agents, np.float64)
    known = np.asarray(scene.agent_known)
    vehicle, walker = types == AgentType.VEHICLE, types == AgentType.PEDESTRIAN
    other = vehicle.copy()
    other[:1] = False
    step = np.diff(np.asarray(scene.lanes, np.float64)[..., :2], axis=1)
    chord = np.arctan2(step[..., 1], step[..., 0])
    turn = np.abs(((np.diff(chord, axis=1) + np.pi) % (2 * np.pi) - np.pi).sum(-1))
    values = {
        "lanes": [len(scene.lanes)],
        "agents": [(types != AgentType.STATIC).sum()],
        "vehicles": [vehicle.sum()],
        "pedestrians": [walker.sum()],
        "cyclists": [(types == AgentType.CYCLIST).sum()],
        "vehicle_speed": agents[other & known[:, 3], 3],
        "ego_speed": agents[:1, 3],
        "pedestrian_speed": agents[walker & known[:, 3], 3],
        "vehicle_length": agents[other & known[:, 6], 6],
        "vehicle_width": agents[other & known[:, 7], 7],
        "lane_length": np.hypot(step[..., 0], step[..., 1]).sum(-1),
        "lane_turn": np.degrees(turn),
        "heading": np.degrees(np.abs(np.arctan2(agents[other, 5], agents[other, 4]))),
        "lane_offset": lane_offsets(scene)[0],
    }
    values = {name: histogram(np.asarray(value, float), *HISTOGRAMS[name][1:]) for name, value in values.items()}
    own = scene_realism(scene)
    flags = {
        "with_pedestrians": walker.any(),
        "with_cyclists": (types == AgentType.CYCLIST).any(),
        "with_signals": (np.asarray(scene.signals) != Signal.UNKNOWN).any(),
    }
    values |= {f"share/{name}": np.array(own[name]) for name in SHARES if name in own}
    values |= {f"share/{name}": np.array([float(flag), 1.0]) for name, flag in flags.items()}
    return values | {f"graph/{name}": value for name, value in scene_sums(scene).items()}


def distances(ours: Sums, reference: Sums) -> dict[str, float]:
    """Jensen-Shannon divergence of each histogram, Fréchet distance of each quantity of the lane graph."""
    graph = [{name[6:]: side[name] for name in side if name.startswith("graph/")} for side in (ours, reference)]
    values = {name: jensen_shannon(ours[name], reference[name]) for name in HISTOGRAMS}
    return values | {name: value for name, value in table(*graph).items() if name.startswith("frechet_")}


def compare(ours: ClusterSums, reference: ClusterSums) -> Comparison:
    """Distances beside their floors, and shares."""
    floor = reference.floor(distances, splits=100)
    ours_total, reference_total = ours.total, reference.total
    values = distances(ours_total, reference_total)
    quantities = {}
    for name, histogram_of in HISTOGRAMS.items():
        means = (_mean(side[name], histogram_of.low, histogram_of.width) for side in (ours_total, reference_total))
        quantities[histogram_of.title] = (*means, values[name], floor[name][0])
    for name in GRAPH:
        graph = f"frechet_{name}"
        quantities[f"{name} of the lane graph"] = (None, None, values[graph], floor[graph][0])
    shares = {}
    for name, title in SHARES.items():
        pairs = (side[f"share/{name}"] for side in (ours_total, reference_total))
        here, there = (100 * part / max(whole, 1) for part, whole in pairs)
        shares[title] = (float(here), float(there))
    return Comparison(quantities, shares)


def markdown(comparison: Comparison, command: str) -> str:
    """The page: a table of distances and floors, and one of shares."""
    rows = [
        [
            title,
            *("" if mean is None else f"{mean:.2f}" for mean in (here, there)),
            f"{distance:.4f}",
            f"{floor:.4f}",
            f"{distance / max(floor, 1e-9):.1f}",
        ]
        for title, (here, there, distance, floor) in comparison.quantities.items()
    ]
    head = ["quantity", "mean here", "mean of the reference", "distance", "floor", "ratio"]
    shares = [[title, f"{here:.1f} %", f"{there:.1f} %"] for title, (here, there) in comparison.shares.items()]
    lines = ["# Synthetic and real scenes", "", f"`{command}`", "", *table_lines(head, rows)]
    return "\n".join([*lines, "", *table_lines(["share", "here", "reference"], shares)]) + "\n"


def draw(ours: Sums, reference: Sums) -> Figure:
    """Histograms of both sides, normalized."""
    columns = 4
    figure = new_figure(4.2 * columns, 2.6 * math.ceil(len(HISTOGRAMS) / columns))
    axes = figure.subplots(math.ceil(len(HISTOGRAMS) / columns), columns).ravel()
    for ax, (name, (title, low, _, width)) in zip(axes, HISTOGRAMS.items(), strict=False):
        for sums, label, style in ((reference, "reference", {"color": "0.7"}), (ours, "here", {"color": "tab:blue"})):
            share = sums[name] / max(sums[name].sum(), 1)
            edges = low + width * np.arange(len(share) + 1)
            if label == "reference":
                ax.stairs(share, edges, fill=True, label=label, **style)
            else:
                ax.stairs(share, edges, label=label, linewidth=1.6, **style)
        ax.set_title(title, fontsize=9)
        ax.tick_params(labelsize=7)
    axes[0].legend(fontsize=8)
    for ax in axes[len(HISTOGRAMS) :]:
        ax.set_axis_off()
    return figure


def _mean(counts: np.ndarray, low: float, width: float) -> float:
    """Mean of a histogram, from the centers of its bins."""
    return float((counts * (low + width * (np.arange(len(counts)) + 0.5))).sum() / max(counts.sum(), 1))


if __name__ == "__main__":
    main()
