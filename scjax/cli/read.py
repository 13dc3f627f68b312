"""scjax read: what is understood of prompts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from scjax.cli.options import json_option

if TYPE_CHECKING:
    from scjax.language.reader.targets import Reading


@click.command("read")
@click.argument("prompts", nargs=-1, required=True, metavar="PROMPT...")
@click.option("--reader", "folder", required=True, metavar="DIR", help="Folder of a trained reader; none ships yet.")
@json_option
def read_command(prompts, folder, as_json) -> None:
    """Shows what is understood of every PROMPT, in any of eleven languages, and how surely.

    \b
    python -m experiments.train_reader runs/reader
    scjax read "vier Autos an der Kreuzung, die Ampel ist rot" --reader runs/reader/model

    docs/attributes.md explains the names. What is not listed is not understood, or not requested.
    """
    from scjax.generate.prompt_reader import load_reader
    from scjax.language.attributes.contradictions import find_contradictions

    readings = load_reader(Path(folder))(list(prompts))
    contradictions = [find_contradictions(reading.request) for reading in readings]
    if as_json:
        rows: list[dict[str, Any]] = [
            {"prompt": prompt, **reading._asdict(), "contradictions": pairs}
            for prompt, reading, pairs in zip(prompts, readings, contradictions, strict=True)
        ]
        click.echo(json.dumps(rows, indent=1, ensure_ascii=False))
        return
    for prompt, reading, pairs in zip(prompts, readings, contradictions, strict=True):
        click.echo(prompt)
        click.echo("\n".join(_lines(reading)))
        for pair in pairs:
            click.echo(f"  contradiction: {' and '.join(pair)}")


def _lines(reading: Reading) -> list[str]:
    if not reading.request:
        return ["  nothing is understood"]
    return [
        f"  {name:<22}{_shown(value):<30}{100 * reading.shares[name]:.0f} %" for name, value in reading.request.items()
    ]


def _shown(value: Any) -> str:
    if isinstance(value, tuple) and value and isinstance(value[0], int | float):
        least, most = value
        return f"{least:g}" if least == most else f"{least:g} or more" if most is None else f"{least:g} to {most:g}"
    if isinstance(value, tuple):
        return ", ".join(value)
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
