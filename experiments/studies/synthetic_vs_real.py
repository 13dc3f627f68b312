"""Compares one set of scenes with another by their distributions, beside the floor of the second set.

The floor is what two halves of the reference, of other locations, differ by.

    python -m experiments.studies.synthetic_vs_real records:runs/synthetic#val tiles:shared/eval/tiles_real_train.npz --out comparison

Writes comparison.md (a table) and comparison.png (histograms). SCENES and REFERENCE are sources as scjax.evaluate
takes them: records:FOLDER#SPLIT, npz:FOLDER, tiles:FILE#main.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.studies.arguments import parser_of
from scjax.evaluate.sources import SceneSource, open_source
from scjax.metrics.cluster_sums import ClusterSums
from scjax.metrics.distances import histogram, jensen_shannon
from scjax.metrics.distributions import GRAPH, Sums, scene_sums, table
from scjax.metrics.realism import lane_offsets, scene_realism
from scjax.scene import AgentType, Scene, Signal

# Name -> title, lowest, highest, bin width.
HISTOGRAMS = {
    "lanes": ("lanes a scene", 0.0, 80.0, 4.0),
    "agents": ("agents a scene", 0.0, 61.0, 2.0),
    "vehicles": ("vehicles a scene", 0.0, 61.0, 2.0),
    "pedestrians": ("pedestrians a scene", 0.0, 20.0, 1.0),
    "cyclists": ("cyclists a scene", 0.0, 6.0, 1.0),
    "vehicle_speed": ("speed of other vehicles [m/s]", 0.0, 35.0, 1.0),
    "ego_speed": ("speed of the ego [m/s]", 0.0, 35.0, 2.0),
    "pedestrian_speed": ("speed of pedestrians [m/s]", 0.0, 4.0, 0.25),
    "vehicle_length": ("length of vehicles [m]", 3.0, 14.0, 0.2),
    "vehicle_width": ("width of vehicles [m]", 1.4, 3.4, 0.1),
    "lane_length": ("length of lanes [m]", 0.0, 70.0, 2.5),
    "lane_turn": ("turn of lanes [degrees]", 0.0, 180.0, 7.5),
    "heading": ("heading of other vehicles [degrees]", 0.0, 180.0, 7.5),
    "lane_offset": ("vehicles off their lane [m]", 0.0, 2.5, 0.125),
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
    parser = parser_of("compare", __doc__)
    parser.add_argument("scenes", metavar="SCENES", help="source of the scenes in question")
    parser.add_argument("reference", metavar="REFERENCE", help="source of the scenes that they should be like")
    add = parser.add_argument
    add("--out", type=Path, default=Path("comparison"), help="path without ending (default %(default)s)")
    add("--limit", type=int, default=2000, metavar="N", help="scenes of each at most (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        ours, reference = (cluster_sums_of(open_source(text), args.limit) for text in (args.scenes, args.reference))
        text = markdown(ours, reference)
        args.out.with_suffix(".md").write_text(text)
        draw(ours.total, reference.total, args.out.with_suffix(".png"))
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.synthetic_vs_real: {error}")
    print(text)


def cluster_sums_of(source: SceneSource, limit: int) -> ClusterSums:
    """Sums of a source's scenes, at most ``limit`` of them, evenly chosen."""
    clusters = source.clusters
    rows = np.unique(np.linspace(0, len(clusters) - 1, min(limit, len(clusters))).astype(int))
    cluster_sums = ClusterSums()
    for row in tqdm(rows, "scenes", disable=None):
        cluster_sums.add(sums_of(source.read([int(row)])[0]), clusters[row])
    return cluster_sums


def sums_of(scene: Scene) -> Sums:
    """What one scene adds to the histograms, shares and graph quantities."""
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
    found = {name: histogram(np.asarray(value, float), *HISTOGRAMS[name][1:]) for name, value in values.items()}
    own = scene_realism(scene)
    flags = {
        "with_pedestrians": walker.any(),
        "with_cyclists": (types == AgentType.CYCLIST).any(),
        "with_signals": (np.asarray(scene.signals) != Signal.UNKNOWN).any(),
    }
    found |= {f"share/{name}": np.array(own[name]) for name in SHARES if name in own}
    found |= {f"share/{name}": np.array([float(flag), 1.0]) for name, flag in flags.items()}
    return found | {f"graph/{name}": value for name, value in scene_sums(scene).items()}


def distances(ours: Sums, reference: Sums) -> dict[str, float]:
    """Jensen-Shannon divergence of every histogram, Fréchet distance of every quantity of the lane graph."""
    graph = [{name[6:]: side[name] for name in side if name.startswith("graph/")} for side in (ours, reference)]
    found = {name: jensen_shannon(ours[name], reference[name]) for name in HISTOGRAMS}
    return found | {name: value for name, value in table(*graph).items() if name.startswith("frechet_")}


def markdown(ours: ClusterSums, reference: ClusterSums) -> str:
    """The table of distances and floors, and the one of shares."""
    floor = reference.floor(distances, splits=100)
    found, sums, real = distances(ours.total, reference.total), ours.total, reference.total
    lines = ["| quantity | mean here | mean of the reference | distance | floor | ratio |", "|---|---|---|---|---|---|"]
    for name, (title, low, _, width) in HISTOGRAMS.items():
        means = [_mean(side[name], low, width) for side in (sums, real)]
        lines.append(_line(title, *(f"{mean:.2f}" for mean in means), found[name], floor[name][0]))
    for name in GRAPH:
        lines.append(_line(f"{name} of the lane graph", "", "", found[f"frechet_{name}"], floor[f"frechet_{name}"][0]))
    lines += ["", "| share | here | reference |", "|---|---|---|"]
    for name, title in SHARES.items():
        here, there = (100 * part / max(whole, 1) for part, whole in (side[f"share/{name}"] for side in (sums, real)))
        lines.append(f"| {title} | {here:.1f} % | {there:.1f} % |")
    return "\n".join(lines) + "\n"


def draw(ours: Sums, reference: Sums, path: Path) -> None:
    """Histograms of both sides, each adding up to one."""
    columns = 4
    figure = Figure(figsize=(4.2 * columns, 2.6 * math.ceil(len(HISTOGRAMS) / columns)), layout="constrained")
    FigureCanvasAgg(figure)
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
    figure.savefig(path, dpi=70)


def _mean(counts: np.ndarray, low: float, width: float) -> float:
    """Mean of a histogram, by the middles of its bins."""
    return float((counts * (low + width * (np.arange(len(counts)) + 0.5))).sum() / max(counts.sum(), 1))


def _line(title: str, here: str, there: str, value: float, floor: float) -> str:
    return f"| {title} | {here} | {there} | {value:.4f} | {floor:.4f} | {value / max(floor, 1e-9):.1f} |"


if __name__ == "__main__":
    main()
