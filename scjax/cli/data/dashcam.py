"""``scjax data dashcam``: a rendered dashcam picture for every record of synthetic worlds."""

from __future__ import annotations

import click

from scjax.cli.data.command import CONTINUE, DataCommand, workers_option


@click.command(
    "dashcam",
    short_help="Rendered dashcam pictures of records of synthetic worlds.",
    cls=DataCommand,
    interrupted=CONTINUE,
)
@click.argument("records", metavar="RECORDS")
@click.argument("out", metavar="PICTURES")
@workers_option
def data_dashcam(records: str, out: str, workers: int) -> int:
    """Renders what a dashcam on the ego of each record sees, with light, weather and height of its own.

    \b
    scjax data synthetic runs/records --worlds 1000
    scjax data dashcam runs/records runs/pictures

    PICTURES receives SPLIT-ROW.jpg for every record, a standard view of 224 x 224 pixels (docs/images.md), and
    SPLIT-ROW.npz: depth, classes, objects and lanes of its cells, from which the vision network learns.
    """
    from scjax.synthetic.pictures import render_records

    click.echo(f"{render_records(records, out, workers=workers)} new pictures in {out}")
    return 0
