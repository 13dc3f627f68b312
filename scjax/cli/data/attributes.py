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
@click.option("--forward", is_flag=True, help="The windows ahead of the ego, for training on pictures and attributes.")
@workers_option
def data_attributes(records: str, forward: bool, workers: int) -> int:
    """Measures all attributes of every record, once, for training on attributes.

    RECORDS receives attributes-train.jsonl.gz and attributes-val.jsonl.gz, one line per record in record order; with
    --forward they begin with attributes-forward.
    """
    from scjax.data.measurements import measure_records
    from scjax.scene import Crop

    crop = Crop.FORWARD if forward else Crop.CENTERED

    for split, count in measure_records(records, crop=crop, workers=workers).items():
        click.echo(f"{split}: {count} records measured")
    return 0
