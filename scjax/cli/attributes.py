"""scjax attributes: what the scenes in a file show, and whether they show what a request asks for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from scjax.cli.scene_files import read_scenes, strict_option


def _request(text: str) -> Any:
    """The request in a JSON file, or in a JSON text."""
    is_text = text.lstrip().startswith("{")
    try:
        content = json.loads(text if is_text else Path(text).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"--ask {text[:60]} is no JSON: {error}") from error
    return content["asks"] if isinstance(content, dict) and isinstance(content.get("asks"), dict) else content


@click.command("attributes")
@click.argument("file")
@click.option("--ask", metavar="JSON", help='Request: a JSON file, or JSON such as {"layout": "T", "vehicles": 3}.')
@strict_option
@click.option("--json", "as_json", is_flag=True, help="Print measurements as JSON, one object a scene.")
def attributes_command(file, ask, strict, as_json) -> None:
    """Measures the scenes in FILE: roads, lanes, traffic, signals, events.

    With --ask, prints which part of the request each scene misses. docs/attributes.md explains every name. FILE holds
    scenes (.npz or .json) or a recording (.json.gz), of which the scene around its first pose is taken.
    """
    from scjax.language.analysis.scene_analysis import analyze
    from scjax.language.attributes.table import check_attributes, measure_attributes, score_attributes

    request = None if ask is None else check_attributes(_request(ask))
    rows = []
    for scene in read_scenes(file, strict=strict):
        analysis = analyze(scene)
        row: dict[str, Any] = {"attributes": measure_attributes(analysis)}
        if request is not None:
            row |= score_attributes(analysis, request)._asdict()
        rows.append(row)
    if as_json:
        click.echo(json.dumps(rows, indent=1))
        return
    for number, row in enumerate(rows):
        click.echo(f"scene {number}")
        if request is not None:
            missed = ", ".join(f"{name} is {_shown(value)}" for name, value in row["misses"].items())
            click.echo(f"  {100 * row['share']:.0f} % of the request holds{'; ' if missed else ''}{missed}")
            continue
        for name, value in row["attributes"].items():
            click.echo(f"  {name:<22}{_shown(value)}")


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(value) or "-"
    if isinstance(value, float):
        return f"{value:.1f}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "-" if value is None else str(value)
