"""How does the guidance scale act on the entries of an ablation? A table and a plot from reports at several scales.

    for scale in 1 2 4 6; do
        python -m experiments.studies.ablation --config=experiments/studies/ablation/config.py:recipe \\
            --workdir=runs/recipe --config.guidance=$scale && cp runs/recipe/ablation.json runs/guidance-$scale.json
    done
    python -m experiments.studies.ablation.guidance runs/guidance-*.json --out=docs/results/ablation_guidance

Models are trained once; a further scale only samples again. Writes OUT.md, OUT.json and OUT.png.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from experiments.studies.ablation.judge import METRICS
from experiments.studies.ablation.report import Spread, summary
from experiments.studies.page import command_line, new_figure, script_parser, table_lines, write_page

_SHOWN = ("prompt", "lane CCS", "agent CCS", "vehicles_on_lane", "open_connections", "vehicles_overlapping")

Curves = dict[str, dict[float, dict[str, Any]]]
"""Title of an entry -> guidance scale -> metric -> spread over seeds (``report.summary``), scales ascending."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.ablation.guidance", __doc__)
    parser.add_argument(
        "files", nargs="+", type=Path, help="ablation.json files that differ in the guidance scale only"
    )
    parser.add_argument("--out", type=Path, default=Path("guidance"), help="path without ending (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        curves = read(args.files)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.ablation.guidance: {error}")
    write_page(args.out, markdown(curves, command_line("ablation.guidance", arguments)), curves, draw(curves))
    print(args.out.with_name(f"{args.out.name}.md"))


def read(paths: Sequence[Path]) -> Curves:
    """The curves of all reports.

    Raises:
      ValueError: a file is none of ``experiments.studies.ablation``, differs in more than the scale, or repeats one.
    """
    reports: dict[float, tuple[Path, Mapping[str, Any]]] = {}
    common: dict[str, Any] = {}
    for path in paths:
        try:
            content = json.loads(path.read_text())
            setting, rows = dict(content["setting"]), summary(content["runs"])
            scale = float(setting.pop("guidance"))
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(
                f"{path} is not what experiments.studies.ablation writes ({error}): give its ablation.json"
            ) from None
        if scale in reports:
            raise ValueError(f"{path} and {reports[scale][0]} both have guidance {scale:g}: give one of each")
        common = common or setting
        if differing := sorted(
            name for name in setting.keys() | common.keys() if setting.get(name) != common.get(name)
        ):
            raise ValueError(
                f"{path} was made with another {', '.join(differing)} than {paths[0]}: they do not compare"
            )
        reports[scale] = path, {row["title"]: row["metrics"] for row in rows}
    curves: Curves = {}
    for scale in sorted(reports):
        for title, metrics in reports[scale][1].items():
            curves.setdefault(title, {})[scale] = metrics
    return curves


def markdown(curves: Curves, command: str) -> str:
    """The page: a row per entry and guidance scale."""
    rows = [
        [
            title,
            f"{scale:g}",
            metrics["prompt"]["over_shuffled"].format(),
            *(metrics[name]["own"].format() for name in _SHOWN),
        ]
        for title, points in curves.items()
        for scale, metrics in points.items()
    ]
    head = ["entry", "guidance", "prompt over shuffled", *map(_with_direction, _SHOWN)]
    return "\n".join(["# Guidance scale in the ablation", "", f"`{command}`", "", *table_lines(head, rows)]) + "\n"


def draw(curves: Curves) -> Figure:
    """A panel per metric, a line per entry; bars: intervals over seeds; dashed: shuffled conditions."""
    columns = 3
    lines = len(_SHOWN) // columns
    figure = new_figure(4.0 * columns, 2.9 * lines)
    axes = figure.subplots(lines, columns).ravel()
    for axis, name in zip(axes, _SHOWN, strict=True):
        for place, (title, points) in enumerate(curves.items()):
            scales = list(points)
            shifted = [scale * (1 + 0.015 * (place - len(curves) / 2)) for scale in scales]  # keeps bars apart
            own: list[Spread] = [points[scale][name]["own"] for scale in scales]
            half = [spread.half if math.isfinite(spread.half) else 0.0 for spread in own]
            bars = axis.errorbar(shifted, [spread.mean for spread in own], half, fmt=".-", lw=1, label=title)
            color = bars.lines[0].get_color()
            axis.plot(scales, [points[scale][name]["shuffled"].mean for scale in scales], "--", lw=0.7, c=color)
        axis.set_title(f"{METRICS[name].title} ({_with_direction(name)})", fontsize=9)
        axis.set_xscale("log")
        ticks = sorted({scale for points in curves.values() for scale in points})
        axis.set_xticks(ticks, [f"{scale:g}" for scale in ticks], fontsize=7)
        axis.minorticks_off()
        axis.tick_params(labelsize=7)
        axis.grid(alpha=0.3, lw=0.4)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(curves), fontsize=7)
    figure.supxlabel("guidance scale (dashed: shuffled conditions)", fontsize=9)
    return figure


def _with_direction(name: str) -> str:
    return f"{name} {'↑' if METRICS[name].more_is_better else '↓'}"


if __name__ == "__main__":
    main()
