"""scjax export: scenes, maps and recordings in files that other programs open."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from scjax.cli.options import json_option
from scjax.cli.output import say, writable_folder
from scjax.cli.scene_files import read_content

if TYPE_CHECKING:
    from scjax.scene import Log, Map, Scene


class CommandWithFormats(click.Command):
    """A command whose help ends with the table of formats, which is imported to print it."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The options, then the formats: name, file or folder, the programs that open them."""
        from scjax.export import EXPORTS

        super().format_options(ctx, formatter)
        with formatter.section("Formats"):
            rows = [(name, f"{one.title}, {one.suffix or 'folder'}: {one.consumers}") for name, one in EXPORTS.items()]
            formatter.write_dl(rows)


@click.command("export", cls=CommandWithFormats)
@click.argument("file")
@click.option("--to", "format", metavar="FORMAT", required=True, help="Format to write, one of those below.")
@click.option(
    "--out", metavar="PATH", help="File or folder to write. [default: the name of FILE in this folder, with an ending]"
)
@click.option("--scene", "number", type=click.IntRange(min=0), help="Scene of a file of several. [default: 0]")
@json_option
def export_command(file, format, out, number, as_json) -> None:
    """Writes what FILE holds in the format of another program.

    FILE is anything that scjax plot draws: a scene, a map, a log, or a file of another program. A scene or map has one
    step. Files of Lanelet2, SUMO, Waymo, ClipGT and RDS-HQ hold the map alone and need roadgen (scjax[formats]).

    The names of the files go to stdout. On stderr stands what the format cannot say about this log, and what was
    unknown and had to be filled in, with counts.

    \b
    scjax export rollout.npz --to scenarionet --out scenarios
    scjax export scene.json --to opendrive --out crossing.xodr

    Exit status 0: the files are written; 1: one line says what is wrong with FILE, or what the format needs.
    """
    from scjax.export import EXPORTS, export_log

    if format not in EXPORTS:
        raise click.UsageError(f"--to is {format!r}: choose from {', '.join(EXPORTS)}")
    suffix = EXPORTS[format].suffix
    path = Path(out) if out else _default_path(file, format, suffix)
    log = log_of_content(read_content(file), file, number)
    writable_folder(path if not suffix and format == "scenarionet" else path.parent)
    try:
        report = export_log(log, path, format)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    if as_json:
        content = {"format": format, "files": list(map(str, report.paths)), "losses": report.losses}
        click.echo(json.dumps(content, indent=1))
        return
    for written in report.paths:
        click.echo(str(written))
    for words, count in report.losses.items():
        say(f"{count:>6}  {words}")


def _default_path(file: str, format: str, suffix: str) -> Path:
    """The name of FILE with another ending, or with the format for a folder; never FILE itself."""
    name = Path(file).name
    stem = name.removesuffix(".gz").rpartition(".")[0] or name
    path = Path(f"{stem}{suffix}" if suffix else f"{stem}-{format}")
    return Path(f"{stem}-{format}{suffix}") if path == Path(file) else path


def log_of_content(content: Scene | Log | Map, file: str, number: int | None) -> Log:
    """The content of a file as a log; a scene or map as one of one step.

    Raises:
      ValueError: the file holds no such scene.
    """
    from scjax.cli.scene_files import scenes_of_content
    from scjax.scene import Map, Scene, map_to_log, scene_to_map

    if isinstance(content, Scene):
        scenes = scenes_of_content(content, file)
        if (number or 0) >= len(scenes):
            raise ValueError(f"{file} holds {len(scenes)} scenes, counted from 0: there is no scene {number}")
        return map_to_log(scene_to_map(scenes[number or 0]))
    if number is not None:
        raise click.UsageError("--scene is for files of scenes: this one holds a map or a log")
    return map_to_log(content) if isinstance(content, Map) else content
