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
@click.option("--reader", "folder", metavar="DIR", help="Folder of a trained reader. [default: the one that ships]")
@json_option
def read_command(prompts, folder, as_json) -> None:
    """Shows what is understood of every PROMPT, in any of eleven languages, and how surely.

    \b
    scjax read "vier Autos an der Kreuzung, die Ampel ist rot"
    scjax read "empty motorway" --reader runs/reader/model

    docs/attributes.md explains the names. What is not listed is not understood, or not requested. "Perhaps" stands
    beside what is less likely than not: it decides between outlines that show the rest (docs/generate.md).
    """
    from scjax.generate.prompt_reader import load_reader
    from scjax.language.attributes.contradictions import find_contradictions
    from scjax.nn.startup import start_jax

    start_jax()
    readings = load_reader(None if folder is None else Path(folder))(list(prompts))
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
    from scjax.language.attributes.shown import shown_value

    rows = [(name, value, f"{100 * reading.shares[name]:.0f} %") for name, value in reading.request.items()]
    rows += [(name, value, "perhaps") for name, value in reading.likely.items()]
    lines = [f"  {name:<22}{shown_value(value):<30}{share}" for name, value, share in rows]
    return lines if reading.request else ["  nothing is understood", *lines]
