"""scjax plot: pictures of scenes, maps and recordings, and animations of recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from scjax.cli.output import progress_bar, writable_folder
from scjax.cli.scene_files import checked_scenes, read_content, scenes_of_content, strict_option

if TYPE_CHECKING:
    from scjax.scene import Log, Map, Scene

MAX_PANELS = 400
"""Scenes in one picture."""

_ENDINGS = (".png", ".svg")
_ANIMATIONS = (".gif", ".mp4")


class Place(click.ParamType):
    """A place on a map, and the direction in which the scene looks: X,Y or X,Y,DEGREES."""

    name = "X,Y[,DEGREES]"

    def convert(self, value, param, ctx) -> tuple[float, ...]:
        """Two or three numbers; UsageError otherwise."""
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except (AttributeError, ValueError):
            numbers = ()
        if len(numbers) not in (2, 3):
            self.fail(f"{value!r} is no place: write meters and degrees, as in 120,-40.5,90", param, ctx)
        return numbers


@click.command("plot")
@click.argument("file")
@click.option(
    "--out",
    metavar="FILE",
    help="Picture to write, .png or .svg; of a recording also .gif or .mp4. [default: FILE with the ending .png]",
)
@click.option(
    "--view",
    type=click.Choice(["auto", "map", "scene"]),
    default="auto",
    show_default=True,
    help="The whole map, or 64 m around the first vehicle; auto takes the map where no vehicle is.",
)
@click.option(
    "--at",
    type=Place(),
    help="The scene at this place of the map instead, around a standing ego that looks that way (0: to +x).",
)
@click.option("--step", type=click.IntRange(min=0), help="Step of a recording, for --view map and --at. [default: 0]")
@click.option("--follow", metavar="ID", help="Object in the middle of an animation. [default: the ego]")
@click.option(
    "--radius", type=click.FloatRange(1, 5000), help="From the middle to the edge of an animation, in meters."
)
@click.option("--heading-up", is_flag=True, help="Turn an animation so that the object in the middle looks up.")
@click.option("--speeds", is_flag=True, help="Also draw how far every agent of a scene moves in one second.")
@strict_option
def plot_command(file, out, view, at, step, follow, radius, heading_up, speeds, strict) -> None:
    """Draws what FILE holds from above: scenes, a map or a recording.

    The content of FILE tells its format, whatever its name is.

    \b
    scjax                 scenes (.npz, .json), maps (.npz, .json), logs (.npz), recordings (.json.gz)
    OpenDRIVE             .xodr: roads, junctions, lights for cars
    CommonRoad            .xml, versions 2018b and 2020a: lanelets, lights, obstacles over time
    Lanelet2              .osm, in degrees or with local_x and local_y: lanelets, lights
    ScenarioNet           .pkl: tracks, lights and map; nothing in the file is executed
    Argoverse 2           log_map_archive_*.json: lane segments

    A map shows lanes for cars as bands with arrows and all other lanes as thin lines. Dots are where lanes follow each
    other, rings are stop points of lights. Borders of tiles, seams and routes are drawn where a map has them.

    \b
    scjax plot Town01.xodr                           the whole map
    scjax plot Town01.xodr --at 120,-2,90            the 64 m x 64 m around a place, looking north
    scjax plot USA_US101-3_3_T-1.xml --view map --step 20
    scjax plot scenes.npz --speeds                   all scenes of a file side by side
    scjax plot log.npz --out clip.mp4 --heading-up   an animation (MP4 needs pip install 'scjax[video]')

    Exit status 0: the picture is written; 1: one line says what is wrong with FILE.
    """
    path = Path(out) if out else _picture_name(file)
    is_animation = path.suffix in _ANIMATIONS
    if path.suffix not in (*_ENDINGS, *_ANIMATIONS):
        raise click.UsageError(f"--out is {path}: pictures are .png or .svg files, animations .gif or .mp4")
    if is_animation and (view != "auto" or at is not None or step is not None or speeds):
        raise click.UsageError(f"--out is {path}: --view, --at, --step and --speeds are for pictures, not animations")
    if not is_animation and (follow is not None or radius is not None or heading_up):
        raise click.UsageError(
            "--follow, --radius and --heading-up are for animations: give --out clip.mp4 or clip.gif"
        )
    content = read_content(file)
    if is_animation:
        _write_animation(content, file, path, follow, radius, heading_up)
        click.echo(str(path))
        return
    if at is not None or view == "map" or (view == "auto" and not _has_vehicle(content)):
        _draw_of_map(content, file, path, at, step or 0, speeds)
    else:
        if step is not None:
            raise click.UsageError("--step is for --view map and --at: the scene of a recording is at its first pose")
        scenes = checked_scenes(scenes_of_content(content, file), file, strict=strict)
        _draw_scenes(scenes, file, path, speeds)
    click.echo(str(path))


def _picture_name(file: str) -> Path:
    """FILE with the ending .png; in this folder, if only the name of FILE is given."""
    return Path(file.removesuffix(".gz")).with_suffix(".png")


def _has_vehicle(content: Scene | Log | Map) -> bool:
    """Whether a scene around a vehicle can be drawn; a map made of tiles is shown as a whole."""
    from scjax.scene import AgentType, Map, Scene

    if isinstance(content, Scene):
        return True
    if isinstance(content, Map):
        return not content.tiles and bool((content.agent_types == AgentType.VEHICLE).any())
    return bool((content.object_types == AgentType.VEHICLE).any())


def _write_animation(
    content: Scene | Log | Map, file: str, path: Path, follow: str | None, radius: float | None, heading_up: bool
) -> None:
    from scjax.scene import Log
    from scjax.viz import animate

    if not isinstance(content, Log):
        raise ValueError(f"{file} holds a moment without time: write a picture, or give a log or recording")
    if follow is not None and follow not in content.object_ids:
        raise ValueError(f"--follow is {follow!r}, but {file} has no such object: it has {_some(content.object_ids)}")
    index = None if follow is None else content.object_ids.index(follow)
    writable_folder(path.parent)
    with progress_bar(path.name, "frame", delay=1.0) as progress:
        try:
            animate(content, path, object_index=index, radius=radius, heading_up=heading_up, progress=progress)
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from error


def _some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")


def _draw_scenes(scenes: list[Scene], file: str, path: Path, speeds: bool) -> None:
    from scjax.viz.grid import grid

    if len(scenes) > MAX_PANELS:
        raise ValueError(f"{file} holds {len(scenes)} scenes: a picture shows {MAX_PANELS} at most, split the file")
    writable_folder(path.parent)
    grid(scenes, speeds=speeds, path=path)


def _draw_of_map(
    content: Scene | Log | Map, file: str, path: Path, at: tuple[float, ...] | None, step: int, speeds: bool
) -> None:
    """Draws a whole map, or the scene at a place of it."""
    import numpy as np

    from scjax.data.imports import map_of_content
    from scjax.data.map_crop import crop_map
    from scjax.viz import plot_map

    map = map_of_content(content, file, step)
    writable_folder(path.parent)
    if at is None:
        plot_map(map, title=f"{Path(file).name}: {map.num_lanes} lanes", path=path)
    else:
        yaw = float(np.deg2rad(at[2])) if len(at) == 3 else 0.0
        _draw_scenes([crop_map(map, at[0], at[1], yaw)], file, path, speeds)
