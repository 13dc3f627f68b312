"""scjax data attributes: what the scenes of records show."""

from __future__ import annotations

import click

from scjax.cli.data.command import NOTHING_WRITTEN, DataCommand, workers_option


@click.command(
    "attributes",
    short_help="What every record shows, for training on attributes.",
    cls=DataCommand,
    interrupted=NOTHING_WRITTEN,
)
@click.argument("records", metavar="RECORDS")
@workers_option
def data_attributes(records: str, workers: int) -> int:
    """Measures all attributes of every record, once, for training on attributes.

    RECORDS receives attributes-train.jsonl.gz and attributes-val.jsonl.gz, one line per record in record order.
    """
    from scjax.data.measurements import measure_records

    for split, count in measure_records(records, workers=workers).items():
        click.echo(f"{split}: {count} records measured")
    return 0
