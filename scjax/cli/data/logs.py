"""``scjax data logs``: motion of synthetic worlds as logs."""

from __future__ import annotations

from pathlib import Path

import click

from scjax.cli.data.command import DataCommand
from scjax.cli.output import writable_folder
from scjax.data.ranges import MAX_COUNT, check_number, check_seed


@click.command(
    "logs",
    short_help="Motion of synthetic worlds -> logs of 10 s.",
    cls=DataCommand,
    interrupted="the files written so far are complete; the same command with --force writes them all",
)
@click.argument("out", metavar="DIR")
@click.option("--worlds", type=int, default=4, metavar="N", show_default=True, help="Worlds; each gives three logs.")
@click.option("--seed", type=int, default=0, metavar="S", show_default=True, help="Of all worlds.")
@click.option(
    "--events", multiple=True, metavar="EVENT...", help="Every world with a place for it shows one of these events."
)
@click.option("--gif", is_flag=True, help="Also an animation of every log.")
@click.option("--force", is_flag=True, help="Overwrite files that are there already.")
def data_logs(out: str, worlds: int, seed: int, events: tuple[str, ...], gif: bool, force: bool) -> None:
    """Writes the motion of synthetic worlds: 2 s before and 8 s after a moment at 10 Hz, with map and signals.

    World k of a seed is the same as in scjax data synthetic, and its logs are of the same three moments. A file is read
    with scjax.scene.load_log, and scjax.data.crop_log cuts scenes out of it.

    Example: scjax data logs logs --worlds 8 --gif
    """
    from tqdm import tqdm

    from scjax.language.events import EVENTS
    from scjax.scene import save_log
    from scjax.synthetic.motion import world_logs
    from scjax.viz import animate

    check_number("worlds", worlds, 1, MAX_COUNT, "make at least one world")
    check_seed(seed)
    if unknown := sorted(set(events) - set(EVENTS)):
        raise ValueError(f"events has the unknown event {unknown[0]!r}: choose of {', '.join(EVENTS)}")
    target = writable_folder(out)
    if not force and (existing := sorted(target.glob("*.npz"))):
        raise ValueError(f"{existing[0]}: already there: choose another folder, or overwrite with --force")
    count = 0
    for k in tqdm(range(worlds), "worlds", unit="world", delay=3.0):
        for log in world_logs(seed, k, events):
            file = Path(target, log.metadata.scene_id.replace(" ", "-") + ".npz")
            save_log(log, file)
            if gif:
                animate(log, file.with_suffix(".gif"))
            count += 1
    click.echo(f"{target}: {count} logs of {worlds} worlds")
