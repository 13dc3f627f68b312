"""How does the guidance scale act on adherence and realism?

    python -m experiments.studies.guidance runs/adherence.json --out=docs/results/guidance

Reads the JSON of ``experiments.studies.prompt_adherence`` at several guidance scales. One panel per attribute of the
prompts and per realism value; one line per file, such as models with different condition dropout; dashed: the record
itself.

Writes OUT.md, OUT.json and OUT.png.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

from experiments.studies.page import command_line, new_figure, script_parser, table_lines, write_page
from experiments.studies.prompt_adherence import REALISM, RECORD

Curve = list[tuple[float, float]]
"""(guidance scale, value), scales ascending."""

_ROW = re.compile(r"prompt, guidance (\S+)$")
_COLUMNS = 4


class Curves(NamedTuple):
    """Panel -> curve over guidance scales, and panel -> value of the records."""

    panels: dict[str, Curve]
    record: dict[str, float]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.guidance", __doc__)
    parser.add_argument("files", nargs="+", type=Path, help="JSON of prompt_adherence; the file name labels the line")
    parser.add_argument("--out", type=Path, default=Path("guidance"), help="path without ending (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        files = {path.stem: read(path) for path in args.files}
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.guidance: {error}")
    text = markdown(files, command_line("guidance", arguments))
    write_page(args.out, text, {name: curves._asdict() for name, curves in files.items()}, draw(files))
    print(args.out.with_name(f"{args.out.name}.md"))


def read(path: Path) -> Curves:
    """The curves of one file.

    Raises:
      ValueError: the file is not from ``prompt_adherence``, or holds fewer than two guidance scales.
    """
    try:
        content = json.loads(path.read_text())
        rows, realism = content["rows"], content["realism"]
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is not what experiments.studies.prompt_adherence writes ({error}): give its JSON"
        ) from None
    values = {title: _values(rows[title], realism.get(title, {})) for title in rows}
    titles = {float(match[1]): title for title in values if (match := _ROW.match(title))}
    if len(titles) < 2:
        raise ValueError(
            f"{path} holds {len(titles)} guidance scales: run experiments.studies.prompt_adherence with "
            "--guidance 1 2 4"
        )
    panels: dict[str, Curve] = {}
    for scale in sorted(titles):
        for panel, value in values[titles[scale]].items():
            panels.setdefault(panel, []).append((scale, value))
    return Curves(panels, values.get(RECORD, {}))


def markdown(files: dict[str, Curves], command: str) -> str:
    """The page: a row per file and guidance scale."""
    panels = list(dict.fromkeys(panel for curves in files.values() for panel in curves.panels))
    rows = []
    for name, curves in files.items():
        by_scale = {scale: {} for scale, _ in next(iter(curves.panels.values()))}
        for panel, curve in curves.panels.items():
            for scale, value in curve:
                by_scale.setdefault(scale, {})[panel] = value
        rows += [
            [name, f"{scale:g}", *(f"{values[panel]:.3g}" if panel in values else "" for panel in panels)]
            for scale, values in by_scale.items()
        ]
        if curves.record:
            cells = (f"{curves.record[panel]:.3g}" if panel in curves.record else "" for panel in panels)
            rows.append([name, RECORD, *cells])
    lines = ["# Guidance scale", "", f"`{command}`", "", *table_lines(["file", "guidance", *panels], rows)]
    return "\n".join(lines) + "\n"


def draw(files: dict[str, Curves]) -> Figure:
    """The panels of all files."""
    panels = list(dict.fromkeys(panel for curves in files.values() for panel in curves.panels))
    lines = math.ceil(len(panels) / _COLUMNS)
    figure = new_figure(3.2 * _COLUMNS, 2.4 * lines)
    axes = figure.subplots(lines, _COLUMNS, squeeze=False).ravel()
    for axis, panel in zip(axes, panels, strict=False):
        for name, curves in files.items():
            points = curves.panels.get(panel, [])
            axis.plot([x for x, _ in points], [y for _, y in points], ".-", lw=1, label=name)
            if panel in curves.record:
                axis.axhline(curves.record[panel], color="0.5", lw=0.8, ls="--")
        axis.set_title(panel, fontsize=9)
        axis.tick_params(labelsize=7)
        axis.grid(alpha=0.3, lw=0.4)
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    if len(files) > 1:
        axes[0].legend(fontsize=7)
    figure.supxlabel("guidance scale (dashed: the record itself)", fontsize=9)
    return figure


def _values(scores: dict[str, list[int]], realism: dict[str, float]) -> dict[str, float]:
    """Panel -> value; percentages, or metres."""
    values = {f"{name} [% met]": 100 * hits / total for name, (hits, total) in scores.items()}
    for name, title in REALISM.items():
        if name in realism:
            metres = name.endswith("_m")
            values[title if metres else f"{title} [%]"] = realism[name] * (1 if metres else 100)
    return values


if __name__ == "__main__":
    main()
