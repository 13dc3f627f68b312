"""How an ablation's rows act under guidance: a table and a plot from its reports at several weights.

    for weight in 1 2 4 6; do
        python -m experiments.studies.ablation --config=experiments/studies/ablation/config.py:recipe --workdir=runs/recipe \
            --config.guidance=$weight && cp runs/recipe/ablation.json runs/guidance-$weight.json
    done
    python -m experiments.studies.ablation.guidance runs/guidance-*.json --out runs/guidance.png

Models are trained once: a further weight only samples them anew. The table stands beside the picture, as Markdown.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from experiments.studies.ablation.judge import METRICS
from experiments.studies.ablation.report import Spread, summary
from experiments.studies.arguments import parser_of
from scjax.scene.files import write_text
from scjax.viz.grid import save_figure

_SHOWN = ("prompt", "lane CCS", "agent CCS", "vehicles_on_lane", "open_connections", "vehicles_overlapping")

Curves = dict[str, dict[float, dict[str, Any]]]
"""Title of a row -> guidance weight -> metric -> spread over seeds (``report.summary``), weights ascending."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of("ablate.guidance", __doc__)
    parser.add_argument("files", nargs="+", type=Path, help="ablation.json of equal settings but for the weight")
    parser.add_argument("--out", type=Path, default=Path("guidance.png"), help="picture (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        curves = read(args.files)
        draw(curves, args.out)
        write_text(args.out.with_suffix(".md"), markdown(curves))
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.ablation.guidance: {error}")
    print(args.out, args.out.with_suffix(".md"), sep="\n")


def read(paths: Sequence[Path]) -> Curves:
    """The rows of all reports.

    Raises:
      ValueError: a file is none of ``experiments.studies.ablation``, differs in more than the weight, or repeats one.
    """
    reports: dict[float, tuple[Path, Mapping[str, Any]]] = {}
    common: dict[str, Any] = {}
    for path in paths:
        try:
            content = json.loads(path.read_text())
            setting, rows = dict(content["setting"]), summary(content["runs"])
            weight = float(setting.pop("guidance"))
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(
                f"{path} is not what experiments.studies.ablation writes ({error}): give its ablation.json"
            ) from None
        if weight in reports:
            raise ValueError(f"{path} and {reports[weight][0]} are both of weight {weight:g}: give one of each")
        common = common or setting
        if differing := sorted(
            name for name in setting.keys() | common.keys() if setting.get(name) != common.get(name)
        ):
            raise ValueError(
                f"{path} was made with another {', '.join(differing)} than {paths[0]}: they do not compare"
            )
        reports[weight] = path, {row["title"]: row["metrics"] for row in rows}
    curves: Curves = {}
    for weight in sorted(reports):
        for title, metrics in reports[weight][1].items():
            curves.setdefault(title, {})[weight] = metrics
    return curves


def markdown(curves: Curves) -> str:
    """A line a row and weight."""
    lines = ["| | guidance | prompt over its twin | " + " | ".join(_headed(name) for name in _SHOWN) + " |"]
    lines.append("|---" * (3 + len(_SHOWN)) + "|")
    for title, points in curves.items():
        for weight, metrics in points.items():
            cells = [title, f"{weight:g}", metrics["prompt"]["over_shuffled"].told()]
            lines.append("| " + " | ".join(cells + [metrics[name]["own"].told() for name in _SHOWN]) + " |")
    return "\n".join(lines) + "\n"


def draw(curves: Curves, path: Path) -> Figure:
    """A panel a metric, a line a row; bars: intervals over seeds; dashed: with another scene's condition."""
    columns = 3
    lines = len(_SHOWN) // columns
    figure = Figure(figsize=(4.0 * columns, 2.9 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(lines, columns).ravel()
    for axis, name in zip(axes, _SHOWN, strict=True):
        for place, (title, points) in enumerate(curves.items()):
            weights = list(points)
            moved = [weight * (1 + 0.015 * (place - len(curves) / 2)) for weight in weights]  # bars side by side
            own: list[Spread] = [points[weight][name]["own"] for weight in weights]
            half = [spread.half if math.isfinite(spread.half) else 0.0 for spread in own]
            drawn = axis.errorbar(moved, [spread.mean for spread in own], half, fmt=".-", lw=1, label=title)
            color = drawn.lines[0].get_color()
            axis.plot(weights, [points[weight][name]["shuffled"].mean for weight in weights], "--", lw=0.7, c=color)
        axis.set_title(f"{METRICS[name][0]} ({_headed(name)})", fontsize=9)
        axis.set_xscale("log")
        ticks = sorted({weight for points in curves.values() for weight in points})
        axis.set_xticks(ticks, [f"{weight:g}" for weight in ticks], fontsize=7)
        axis.minorticks_off()
        axis.tick_params(labelsize=7)
        axis.grid(alpha=0.3, lw=0.4)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(curves), fontsize=7)
    figure.supxlabel("guidance weight (dashed: with another scene's condition)", fontsize=9)
    save_figure(figure, path, dpi=100)
    return figure


def _headed(name: str) -> str:
    return f"{name} {'↑' if METRICS[name][1] else '↓'}"


if __name__ == "__main__":
    main()
