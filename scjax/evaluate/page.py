"""The report as one self-contained HTML file, and its tables as CSV and JSON."""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scjax.evaluate.table_notes import PUBLISHED, PUBLISHED_NOTE
from scjax.evaluate.tables import Number, Section

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1500px; padding: 0 1.5rem; color: #1d2530; }
h1 { font-size: 1.7rem; } h2 { margin-top: 2.6rem; border-bottom: 1px solid #d5dbe3; }
p.note { color: #566273; max-width: 75ch; } .wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: 13px; }
th, td { padding: .3rem .7rem; text-align: right; white-space: nowrap; border-bottom: 1px solid #e6eaef; }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0; background: #fff; }
thead th { color: #566273; font-weight: 600; } small { color: #8491a3; display: block; }
tr.floor td { background: #f3f5f8; } td.inside { color: #8491a3; } img { max-width: 100%; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .2rem 1.2rem; }
dt { color: #566273; } dd { margin: 0; }
"""


def report_html(title: str, facts: Mapping[str, str], sections: Sequence[Section], pictures: Mapping[str, Path]) -> str:
    """The report as HTML.

    Args:
      title: of the page.
      facts: name -> value, listed at the head.
      sections: the tables.
      pictures: caption -> PNG file; the page embeds its bytes.
    """
    parts = [f"<h1>{html.escape(title)}</h1>", "<dl>"]
    parts += [f"<dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd>" for name, value in facts.items()]
    parts.append("</dl>")
    for section in sections:
        parts.append(f"<h2>{html.escape(section.title)}</h2><p class=note>{html.escape(section.note)}</p>")
        parts.append(_table(section))
    for caption, path in pictures.items():
        content = base64.b64encode(path.read_bytes()).decode()
        parts.append(f'<h2>{html.escape(caption)}</h2><img alt="{html.escape(caption)}" src="data:image/png;base64,')
        parts.append(f'{content}">')
    parts.append(f"<h2>Published elsewhere</h2><p class=note>{html.escape(PUBLISHED_NOTE)}</p>{_published()}")
    head = f'<meta charset="utf-8"><title>{html.escape(title)}</title><style>{_STYLE}</style>'
    return f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(parts)}</body></html>\n"


def report_json(facts: Mapping[str, str], sections: Sequence[Section]) -> dict[str, Any]:
    """The tables as plain values; unknown numbers are None."""

    def number(one: Number) -> dict[str, float | None]:
        return {key: value if math.isfinite(value) else None for key, value in vars(one).items()}

    tables = {
        section.title: {
            "floor": {name: number(one) for name, one in section.floor.items()},
            "rows": {
                name: {
                    "scenes": row.scenes,
                    "clusters": row.clusters,
                    "numbers": {metric: number(one) for metric, one in row.numbers.items()},
                }
                for name, row in section.rows.items()
            },
        }
        for section in sections
    }
    return {"facts": dict(facts), "tables": tables}


def report_csv(sections: Sequence[Section]) -> str:
    """The tables as CSV, one line per number."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("table", "row", "metric", "value", "low", "high", "scenes", "clusters"))
    for section in sections:
        for name, row in section.rows.items():
            for metric, one in row.numbers.items():
                cells = ("" if math.isnan(value) else f"{value:.6g}" for value in (one.value, one.low, one.high))
                writer.writerow((section.title, name, metric, *cells, row.scenes, row.clusters))
        for metric, one in section.floor.items():
            writer.writerow((section.title, "floor", metric, *(f"{v:.6g}" for v in vars(one).values()), "", ""))
    return text.getvalue()


def write_report(folder: Path, title: str, facts: Mapping[str, str], sections: Sequence[Section], pictures) -> None:
    """Writes report.html, report.json and report.csv, each under a temporary name first."""
    files = {
        "report.json": json.dumps(report_json(facts, sections), indent=1, allow_nan=False) + "\n",
        "report.csv": report_csv(sections),
        "report.html": report_html(title, facts, sections, pictures),
    }
    for name, content in files.items():
        temporary = folder / f".{name}.{os.getpid()}.part"
        temporary.write_text(content, encoding="utf-8")
        temporary.replace(folder / name)


def _table(section: Section) -> str:
    metrics = list(dict.fromkeys(metric for row in section.rows.values() for metric in row.numbers))
    if not metrics:
        return "<p>No method has any number.</p>"
    head = "".join(f"<th>{html.escape(_with_spaces(metric))}</th>" for metric in metrics)
    lines = [f"<div class=wide><table><thead><tr><th>method</th><th>scenes (clusters)</th>{head}</tr></thead><tbody>"]
    if section.floor:
        cells = "".join(_cell(section.floor.get(metric), None) for metric in metrics)
        lines.append(f"<tr class=floor><td>floor (real against real)</td><td></td>{cells}</tr>")
    for name, row in section.rows.items():
        cells = "".join(_cell(row.numbers.get(metric), section.floor.get(metric)) for metric in metrics)
        lines.append(f"<tr><td>{html.escape(name)}</td><td>{row.scenes} ({row.clusters})</td>{cells}</tr>")
    return "".join(lines) + "</tbody></table></div>"


def _cell(one: Number | None, floor: Number | None) -> str:
    """One value with its interval; grey inside the range of the floor."""
    if one is None or math.isnan(one.value):
        return "<td>–</td>"
    within_floor = floor is not None and floor.low <= one.value <= floor.high
    interval = "" if math.isnan(one.low) else f"<small>[{one.low:.3g}, {one.high:.3g}]</small>"
    return f"<td{' class=inside' if within_floor else ''}>{one.value:.4g}{interval}</td>"


def _published() -> str:
    columns = list(dict.fromkeys(column for row in PUBLISHED.values() for column in row))
    lines = ["<div class=wide><table><thead><tr><th>row</th>"]
    lines += [f"<th>{html.escape(column)}</th>" for column in columns] + ["</tr></thead><tbody>"]
    for name, row in PUBLISHED.items():
        cells = "".join(f"<td>{row.get(column, '–')}</td>" for column in columns)
        lines.append(f"<tr><td>{html.escape(name)}</td>{cells}</tr>")
    return "".join(lines) + "</tbody></table></div>"


def _with_spaces(name: str) -> str:
    return name.replace("_", " ")
