"""scjax data caption: facts and sentences for every record."""

from __future__ import annotations

import click

from scjax.cli.data.command import NOTHING_WRITTEN, DataCommand, workers_option


@click.command(
    "caption", short_help="Facts and sentences for every record.", cls=DataCommand, interrupted=NOTHING_WRITTEN
)
@click.argument("records", metavar="RECORDS")
@workers_option
@click.option(
    "--paraphrases", type=int, default=2, metavar="N", show_default=True, help="Texts of each style per record."
)
@click.option(
    "--drop",
    type=float,
    default=0.3,
    metavar="P",
    show_default=True,
    help="Share of the facts that a text leaves out, as people do; 0 writes all facts that its style has words for.",
)
@click.option("--seed", type=int, default=0, metavar="S", show_default=True, help="Seed of the choice of words.")
def data_caption(records: str, workers: int, paraphrases: int, drop: float, seed: int) -> int:
    """Describes every record: facts read off lanes and agents by rule, and sentences made from the facts.

    RECORDS receives captions-train.jsonl.gz and captions-val.jsonl.gz, one line per record in record order. Texts come
    in three styles: one or two short sentences; "ROAD & CONTROL: ... AGENTS: ..."; a paragraph.
    """
    from scjax.data.captions import add_captions

    counts = add_captions(records, paraphrases=paraphrases, drop=drop, seed=seed, workers=workers)
    for split, count in counts.items():
        click.echo(f"{split}: {count} records captioned")
    return 0
