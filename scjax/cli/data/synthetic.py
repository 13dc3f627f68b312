"""scjax data synthetic: training records of a synthetic world."""

from __future__ import annotations

import click

from scjax.cli.data.command import CONTINUE, DataCommand, workers_option
from scjax.data.build_options import BuildOptions


@click.command(
    "synthetic",
    short_help="A synthetic world -> training records; needs no data set.",
    cls=DataCommand,
    interrupted=CONTINUE,
)
@click.argument("out", metavar="RECORDS")
@click.option("--worlds", type=int, default=1000, metavar="N", show_default=True, help="Number of worlds.")
@click.option("--seed", type=int, default=0, metavar="S", show_default=True, help="World k depends on S and k alone.")
@click.option(
    "--ordinary",
    type=float,
    default=1.0,
    metavar="SHARE",
    show_default=True,
    help="Share of scenes without an event, a roundabout, a bend or a yellow light that is kept. A smaller share makes "
    "those frequent.",
)
@click.option(
    "--events",
    multiple=True,
    metavar="EVENT...",
    help='Show one of these, as "double-parking", in every world that has a place for it. An event named twice comes '
    "twice as often; an unknown one is answered with the list of all. [default: any, in some worlds]",
)
@workers_option
@click.option(
    "--split-percent",
    type=float,
    default=5.0,
    metavar="P",
    show_default=True,
    help="Share of worlds held out as the val split.",
)
def data_synthetic(
    out: str, worlds: int, seed: int, ordinary: float, events: tuple[str, ...], workers: int, split_percent: float
) -> int:
    """Makes training records of a synthetic world: streets, motorways, traffic, people and rare events.

    No data set is needed. Every world is a location of its own and gives up to 15 records. RECORDS receives shards and
    manifest.json as from build, and labels (train-labels.jsonl.gz) of what each scene shows.
    """
    from scjax.data.build import build_records
    from scjax.synthetic.source import Worlds

    options = BuildOptions(split_percent=split_percent, files_per_shard=64)
    manifest = build_records(Worlds(seed, worlds, ordinary, events), out, options, workers=workers)
    for split, entry in manifest["splits"].items():
        click.echo(f"{split}: {entry['records']} records of {entry['scenes']} worlds")
    return 0
