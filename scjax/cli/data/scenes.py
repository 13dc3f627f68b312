"""scjax data scenes: scenes of records as files that other tools read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from scjax.cli.data.command import DataCommand
from scjax.cli.output import FORMATS, slug, writable_folder, write_scene
from scjax.data.ranges import MAX_COUNT, check_number, check_seed

if TYPE_CHECKING:
    from scjax.data.shards import RecordShards

_SILENT = 3.0  # s without a progress bar


class _Place(NamedTuple):
    """A record: its split, and its number there."""

    split: str
    row: int


@click.command(
    "scenes",
    short_help="Scenes of records -> files for other tools.",
    cls=DataCommand,
    interrupted="the files written so far are complete; the same command with --force writes them all",
)
@click.argument("records", metavar="RECORDS")
@click.option("--out", required=True, metavar="DIR", help="Folder for the files; created if missing.")
@click.option("-n", "count", type=int, default=16, metavar="N", show_default=True, help="Scenes to write.")
@click.option("--format", "ending", type=click.Choice(FORMATS), default="npz", show_default=True, help="File format.")
@click.option("--split", type=click.Choice(["train", "val"]), help="Only records of this split. [default: both]")
@click.option(
    "--seed", type=int, metavar="S", help="Choose at random, the same seed the same. [default: evenly over the records]"
)
@click.option("--force", is_flag=True, help="Overwrite files that are there already.")
def data_scenes(
    records: str, out: str, count: int, ending: str, split: str | None, seed: int | None, force: bool
) -> None:
    """Writes scenes of records to files, one scene a file.

    A scene is the centered window at the recorded pose, as it is captioned and evaluated. Its file is named after its
    world or recording, its split and its number there: city-0-000012-train-000345.npz.

    npz files hold the arrays exactly and JSON files are easy to read (docs/scenes.md); png and svg are pictures.

    Example: scjax data scenes records --out look -n 20 --format png
    """
    from tqdm import tqdm

    from scjax.data.records import open_records, read_record, sample_scene

    folder = Path(records)
    places = _chosen_places(folder, split, count, seed)
    stored = {name: open_records(folder, name) for name in sorted({place.split for place in places})}
    names = [_file_name(stored, place) for place in places]
    existing = [path for name in names if (path := Path(out, f"{name}.{ending}")).exists()]
    if existing and not force:
        raise ValueError(
            f"{existing[0]}: already there, with {len(existing) - 1} more of {count} files: choose another --out, or "
            "overwrite them with --force"
        )
    target = writable_folder(out)
    for place, name in tqdm(list(zip(places, names, strict=True)), "scenes", unit="scene", delay=_SILENT):
        scene = sample_scene(read_record(stored[place.split], place.row))
        write_scene(scene, target, name, [ending])
    numbers = Counter(place.split for place in places)
    click.echo(f"{target}: {', '.join(f'{number} scenes of {name}' for name, number in numbers.items())}")


def _chosen_places(folder: Path, split: str | None, count: int, seed: int | None) -> list[_Place]:
    """The records to write, in file order.

    Raises:
      ValueError: there are not so many, or an argument is out of its range.
    """
    from scjax.data.manifest import load_manifest

    check_number("-n", count, 1, MAX_COUNT)
    if seed is not None:
        check_seed(seed)
    splits = load_manifest(folder)["splits"]
    sizes = {name: splits[name]["records"] for name in ([split] if split else splits)}
    total = sum(sizes.values())
    if count > total:
        counts = " and ".join(f"{size} records of {name}" for name, size in sizes.items())
        cure = f"give -n {total} or less" if total else "choose another --split, or build more records"
        raise ValueError(f"-n is {count}, but {folder} holds {counts}: {cure}")
    return [_place(sizes, number) for number in choose_numbers(total, count, seed)]


def choose_numbers(total: int, count: int, seed: int | None) -> list[int]:
    """``count`` different numbers below ``total`` in order: at equal distances, or with a seed at random."""
    if seed is None:
        return [(2 * k + 1) * total // (2 * count) for k in range(count)]
    import numpy as np

    return sorted(np.random.default_rng(seed).choice(total, count, replace=False).tolist())


def _place(sizes: Mapping[str, int], number: int) -> _Place:
    for split, size in sizes.items():
        if number < size:
            return _Place(split, number)
        number -= size
    raise IndexError(number)


def _file_name(stored: Mapping[str, RecordShards], place: _Place) -> str:
    """The name of a record's file without its ending. Split and number make it unique, also where ids are not."""
    from scjax.data.records import read_record

    record = read_record(stored[place.split], place.row)
    return f"{slug(record.scene_id)}-{place.split}-{place.row:06d}"
