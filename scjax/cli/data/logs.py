"""``scjax data logs``: motion of synthetic worlds and of towns as logs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from scjax.cli.data.command import DataCommand, workers_option
from scjax.cli.data.scenes import choose_numbers
from scjax.cli.output import writable_folder
from scjax.data.ranges import MAX_COUNT, check_number, check_seed

if TYPE_CHECKING:
    from scjax.scene import Log

_LOGS_PER_WORLD = 3
_TOWN_LOGS = 12
_SEPARATORS = str.maketrans(" /", "--")  # of scene ids, in file names


@click.command(
    "logs",
    short_help="Motion of synthetic worlds or of towns -> logs of 10 s.",
    cls=DataCommand,
    interrupted="the files written so far are complete; the same command with --force writes them all",
)
@click.argument("out", metavar="DIR")
@click.option("--worlds", type=int, metavar="N", help="Synthetic worlds; each gives three logs. [default: 4]")
@click.option("--seed", type=int, default=0, metavar="S", show_default=True, help="Of all that is drawn.")
@click.option(
    "--events", multiple=True, metavar="EVENT...", help="Every world with a place for it shows one of these events."
)
@click.option("--towns", multiple=True, metavar="TOWN...", help="These towns of CARLA, instead of synthetic worlds.")
@click.option("--maps", metavar="DIR", help="OpenDRIVE files (*.xodr) of your own, instead of synthetic worlds.")
@click.option("-n", "count", type=int, metavar="N", help=f"Logs of towns. [default: {_TOWN_LOGS}]")
@click.option(
    "--seconds", type=float, default=120.0, metavar="S", show_default=True, help="Length of the simulation of a town."
)
@workers_option
@click.option("--gif", is_flag=True, help="Also an animation of every log.")
@click.option("--force", is_flag=True, help="Overwrite files that are there already.")
def data_logs(
    out: str,
    worlds: int | None,
    seed: int,
    events: tuple[str, ...],
    towns: tuple[str, ...],
    maps: str | None,
    count: int | None,
    seconds: float,
    workers: int,
    gif: bool,
    force: bool,
) -> None:
    """Writes motion: 2 s before and 8 s after a moment at 10 Hz, with map and signals.

    Without --towns or --maps it is that of synthetic worlds. World k of a seed is the same as in scjax data synthetic,
    and its logs are of the same three moments. The logs of towns are those that scjax data towns cuts records of. They
    need SUMO: pip install 'scjax[traffic]'.

    A file is read with scjax.scene.load_log, and scjax.data.crop_log cuts scenes out of it.

    Example: scjax data logs logs --worlds 8 --gif

    Example: scjax data logs logs --towns Town01 Town02 -n 8 --gif
    """
    from tqdm import tqdm

    from scjax.scene import save_log
    from scjax.viz import animate

    check_seed(seed)
    has_towns = bool(towns or maps)
    if has_towns and (worlds is not None or events):
        raise ValueError("--worlds and --events are of synthetic worlds, not of towns: leave them out")
    if count is not None and not has_towns:
        raise ValueError("-n counts logs of towns: add --towns or --maps, or give --worlds")
    target = writable_folder(out)
    if not force and (existing := sorted(target.glob("*.npz"))):
        raise ValueError(f"{existing[0]}: already there: choose another folder, or overwrite with --force")
    if has_towns:
        total = _TOWN_LOGS if count is None else count
        logs = _town_logs(towns, maps, total, seconds, seed, workers)
    else:
        worlds = 4 if worlds is None else worlds
        total = _LOGS_PER_WORLD * worlds
        logs = _world_logs(seed, worlds, events)
    for log in tqdm(logs, "logs", total=total, unit="log", delay=3.0):
        file = target / f"{log.metadata.scene_id.translate(_SEPARATORS)}.npz"
        save_log(log, file)
        if gif:
            animate(log, file.with_suffix(".gif"))
    click.echo(f"{target}: {total} logs" + ("" if has_towns else f" of {worlds} worlds"))


def _world_logs(seed: int, worlds: int, events: tuple[str, ...]) -> Iterator[Log]:
    from scjax.language.analysis.rare_events import EVENTS
    from scjax.synthetic.motion import world_logs

    check_number("worlds", worlds, 1, MAX_COUNT, "make at least one world")
    if unknown := sorted(set(events) - set(EVENTS)):
        raise ValueError(f"events has the unknown event {unknown[0]!r}: choose of {', '.join(EVENTS)}")
    return (log for k in range(worlds) for log in world_logs(seed, k, events))


def _town_logs(
    towns: tuple[str, ...], maps: str | None, count: int, seconds: float, seed: int, workers: int
) -> Iterator[Log]:
    """Logs at equal distances over all towns."""
    from scjax.towns.source import make_towns
    from scjax.towns.town_maps import fetch_town_maps

    check_number("-n", count, 1, MAX_COUNT)
    source = make_towns(maps or fetch_town_maps(), towns, runs=1, seconds=seconds, seed=seed, workers=workers)
    names = source.names()
    if count > len(names):
        raise ValueError(f"-n is {count}, but the towns give {len(names)} logs: add towns, or more --seconds")
    return (source.log(source.scan(names[k])) for k in choose_numbers(len(names), count, None))
