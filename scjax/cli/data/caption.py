"""scjax data caption: texts as people write them, for every record."""

from __future__ import annotations

import click

from scjax.cli.data.command import NOTHING_WRITTEN, DataCommand, workers_option


@click.command(
    "caption", short_help="Texts as people write them, for every record.", cls=DataCommand, interrupted=NOTHING_WRITTEN
)
@click.argument("records", metavar="RECORDS")
@workers_option
@click.option("--texts", type=int, default=6, metavar="N", show_default=True, help="Texts per record.")
@click.option("--seed", type=int, default=0, metavar="S", show_default=True, help="Seed of the choice of words.")
def data_caption(records: str, workers: int, texts: int, seed: int) -> int:
    """Describes every record: texts as people write them, each with the request that its words make.

    RECORDS receives captions-train.jsonl.gz and captions-val.jsonl.gz, one line per record in record order:
    texts in ten styles and eleven languages, drawn at random. docs/captions.md shows examples.
    """
    from scjax.data.captions import add_captions

    counts = add_captions(records, texts=texts, seed=seed, workers=workers)
    for split, count in counts.items():
        click.echo(f"{split}: {count} records captioned")
    return 0
