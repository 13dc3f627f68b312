"""Draws how guidance acts: python -m experiments.studies.guidance runs/adherence.json --out guidance.png

Reads what ``experiments.studies.prompt_adherence`` wrote at several guidance weights. One panel an attribute of the prompts and one a
number of ``SOUND``, a line a file, such as models of several rates of condition dropout; dashed: the record itself.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from experiments.studies.arguments import parser_of
from experiments.studies.prompt_adherence import SOUND
from scjax.viz.grid import save_figure

Curve = list[tuple[float, float]]
"""(guidance weight, value), weights ascending."""

_ROW = re.compile(r"prompt, guidance (\S+)$")
_RECORD = "the record itself"
_COLUMNS = 4


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of("guidance_curves", __doc__)
    parser.add_argument(
        "files", nargs="+", type=Path, help="JSON of experiments.studies.prompt_adherence; the name is the line's"
    )
    parser.add_argument("--out", type=Path, default=Path("guidance.png"), help="picture (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        draw({path.stem: read(path) for path in args.files}, args.out)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.guidance: {error}")
    print(args.out)


def read(path: Path) -> tuple[dict[str, Curve], dict[str, float]]:
    """Panel -> curve over guidance weights, and panel -> value of the records.

    Raises:
      ValueError: the file is none of ``experiments.studies.prompt_adherence``, or holds fewer than two weights.
    """
    try:
        content = json.loads(path.read_text())
        rows, realism = content["rows"], content["realism"]
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is not what experiments.studies.prompt_adherence writes ({error}): give its JSON"
        ) from None
    values = {title: _values(rows[title], realism.get(title, {})) for title in rows}
    weights = {float(found[1]): title for title in values if (found := _ROW.match(title))}
    if len(weights) < 2:
        raise ValueError(
            f"{path} holds {len(weights)} guidance weights: run experiments.studies.prompt_adherence with --guidance 1 2 4"
        )
    curves: dict[str, Curve] = {}
    for weight in sorted(weights):
        for panel, value in values[weights[weight]].items():
            curves.setdefault(panel, []).append((weight, value))
    return curves, values.get(_RECORD, {})


def draw(files: dict[str, tuple[dict[str, Curve], dict[str, float]]], path: Path) -> Figure:
    """The panels of all files, written to ``path``."""
    panels = list(dict.fromkeys(panel for curves, _ in files.values() for panel in curves))
    lines = math.ceil(len(panels) / _COLUMNS)
    figure = Figure(figsize=(3.2 * _COLUMNS, 2.4 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(lines, _COLUMNS, squeeze=False).ravel()
    for axis, panel in zip(axes, panels, strict=False):
        for name, (curves, record) in files.items():
            points = curves.get(panel, [])
            axis.plot([x for x, _ in points], [y for _, y in points], ".-", lw=1, label=name)
            if panel in record:
                axis.axhline(record[panel], color="0.5", lw=0.8, ls="--")
        axis.set_title(panel, fontsize=9)
        axis.tick_params(labelsize=7)
        axis.grid(alpha=0.3, lw=0.4)
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    if len(files) > 1:
        axes[0].legend(fontsize=7)
    figure.supxlabel("guidance weight (dashed: the record itself)", fontsize=9)
    save_figure(figure, path, dpi=100)
    return figure


def _values(scores: dict[str, list[int]], sound: dict[str, float]) -> dict[str, float]:
    """Panel -> value; percentages but for metres."""
    met = {f"{name} [% met]": 100 * hits / total for name, (hits, total) in scores.items()}
    rest = {
        (title if name.endswith("_m") else f"{title} [%]"): sound[name] * (1 if name.endswith("_m") else 100)
        for name, title in SOUND.items()
        if name in sound
    }
    return met | rest


if __name__ == "__main__":
    main()
