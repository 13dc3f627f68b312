"""``scjax data towns``: training records of real road shapes with simulated traffic."""

from __future__ import annotations

import click

from scjax.cli.data.command import DataCommand, workers_option


@click.command(
    "towns",
    short_help="The towns of CARLA with traffic by SUMO -> training records.",
    cls=DataCommand,
    interrupted="finished simulations and shards are kept; run the same command again to continue",
)
@click.argument("out", metavar="RECORDS")
@click.option(
    "--towns",
    multiple=True,
    metavar="TOWN...",
    help="Only these, as Town01. [default: every town whose license allows it]",
)
@click.option(
    "--maps",
    metavar="DIR",
    help="OpenDRIVE files (*.xodr) of your own, instead of the towns; --split-percent holds some of them back.",
)
@click.option("--runs", type=int, default=2, metavar="N", show_default=True, help="Simulations of each town.")
@click.option("--seconds", type=float, default=120.0, metavar="S", show_default=True, help="Length of each simulation.")
@click.option("--seed", type=int, default=0, metavar="S", show_default=True, help="Of all that is drawn.")
@workers_option
@click.option(
    "--split-percent",
    type=float,
    default=10.0,
    metavar="P",
    show_default=True,
    help="Share of your own maps held out as the val split. Of CARLA's towns it is always Town03 and Town05.",
)
def data_towns(
    out: str,
    towns: tuple[str, ...],
    maps: str | None,
    runs: int,
    seconds: float,
    seed: int,
    workers: int,
    split_percent: float,
) -> int:
    """Makes training records of the towns of CARLA: real road shapes, with signals and traffic simulated by SUMO.

    The maps are fetched once (24 MB, the wheel of py123d) and kept in the cache, as are the simulations. SUMO comes
    with pip install 'scjax[traffic]'. Towns whose origin is not clear are left out. CARLA's assets are under CC-BY:
    what is made of these records has to name CARLA.

    A log is 10 s of traffic around a vehicle. RECORDS receives shards and manifest.json as from build, with the domain
    "carla" and the towns as locations.

    Example: scjax data towns town-records --runs 3
    """
    from scjax.data.build import build_records
    from scjax.data.build_options import BuildOptions, PoseOptions
    from scjax.towns.source import make_towns
    from scjax.towns.town_maps import fetch_town_maps
    from scjax.towns.town_table import ATTRIBUTION, TOWNS

    folder = maps or fetch_town_maps()
    names = towns or (() if maps else tuple(TOWNS))
    source = make_towns(folder, names, runs=runs, seconds=seconds, seed=seed, workers=workers)
    dense = PoseOptions(spacing=8.0, max_poses=10)
    options = BuildOptions(split_percent=split_percent, train_poses=dense)
    manifest = build_records(source, out, options, workers=workers)
    for split, entry in manifest["splits"].items():
        click.echo(f"{split}: {entry['records']} records of {entry['scenes']} logs in {len(entry['clusters'])} towns")
    if not maps:
        click.echo(ATTRIBUTION)
    return 0
