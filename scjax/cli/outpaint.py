"""scjax outpaint: a map that grows from a prompt, a scene or a map."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from scjax.cli.options import json_option, model_option, num_steps_option, seed_option
from scjax.cli.output import progress_bar, say, writable_folder
from scjax.cli.scene_files import read_content, scenes_of_content

if TYPE_CHECKING:
    from scjax.scene import Map, Scene

_ENDINGS = (".npz", ".json")


def _numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise click.UsageError(f"{option} is {text!r}: give {count} numbers, as in {','.join(['10'] * count)}")
    return numbers


@click.command("outpaint")
@click.argument("prompts", nargs=-1, metavar="[PROMPT]...")
@click.option("--start", metavar="FILE", help="Scene or map to begin with, of any format. [default: a new scene]")
@click.option("--length", type=click.FloatRange(1, 20_000), help="Length of the route in meters. [default: 200]")
@click.option(
    "--route",
    default="straight",
    show_default=True,
    metavar="WAY",
    help='"straight", "random", or points to pass in meters: "0,0 100,0 100,200".',
)
@click.option(
    "--area",
    metavar="X0,X1,Y0,Y1",
    help="Grow at all roads that lead out, until they leave this area in meters. Instead of --length.",
)
@click.option("--at", metavar="X,Y,DEGREES", help="Where the route begins on a map, and which way.")
@click.option("--rear", is_flag=True, help="Add what is behind the ego of the forward scene --start, and nothing else.")
@click.option("--candidates", default=8, show_default=True, type=click.IntRange(1, 64), help="Samples for each tile.")
@click.option("--retries", default=2, show_default=True, type=click.IntRange(0, 10), help="Rounds of more samples.")
@num_steps_option
@seed_option
@click.option("--out", default="map.npz", show_default=True, metavar="FILE", help="Map to write, .npz or .json.")
@model_option
@json_option
def outpaint_command(
    prompts, start, length, route, area, at, rear, candidates, retries, num_steps, seed, out, model_folder, as_json
) -> None:
    """Lets a map grow tile by tile, along a route or over an area, and draws it beside the map file.

    With several PROMPTs each is for one tile, and the last for all further ones. The first tile is a scene for the
    first PROMPT, unless --start names a file.

    \b
    scjax outpaint "a two-lane road in a town" --length 300
    scjax outpaint "a straight road" "a roundabout" "a straight road" --out three.npz
    scjax outpaint --start scene.json --route random --length 500
    scjax outpaint --start Town01.xodr --at 120,-2,0 "a T-junction"
    scjax outpaint "a crossing" --area=-100,100,-100,100
    scjax outpaint --start forward.npz --rear

    The map says of every tile whether it is complete. It is shorter than requested where the road ends or where no
    sample continues it; this is said on stderr. `scjax plot` draws the map again, or the scene at any place of it.
    """
    path = Path(out)
    if path.suffix not in _ENDINGS:
        raise click.UsageError(f"--out is {out}: maps are .npz or .json files")
    if length is not None and area is not None:
        raise click.UsageError("--length and --area exclude each other: leave one of them out")
    if rear and (start is None or length is not None or area is not None or at is not None or len(prompts) > 1):
        raise click.UsageError(
            "--rear goes with --start FILE and at most one PROMPT, without --length, --area and --at"
        )
    place = None
    if at is not None:
        x, y, degrees = _numbers(at, 3, "--at")
        place = (x, y, math.radians(degrees))
    window = None if area is None else _numbers(area, 4, "--area")
    way = route
    if "," in route:
        points = [_numbers(point, 2, "--route") for point in route.split()]
        way = [(x, y) for x, y in points]
    writable_folder(path.parent)

    from scjax.nn.startup import start_jax
    from scjax.scene import TileStatus, save_map, validate_map
    from scjax.viz import plot_map

    start_jax()
    begin = None if start is None else _start_of(start)
    sampling = {"candidates": candidates, "retries": retries, "num_steps": num_steps, "model": model_folder}
    if rear:
        first, map = 1, _with_rear(seed, begin, next(iter(prompts), None), str(start), sampling)
    else:
        ways = {"length": length, "route": way, "area": window, "at": place}
        first, map = _grown(seed, begin, list(prompts) or None, ways, sampling)
    save_map(validate_map(map), path)
    plot_map(map, path=path.with_suffix(".png"))
    new = map.tiles[first:]
    for number, tile in enumerate(new, first):
        if tile.status in (TileStatus.INCOMPLETE, TileStatus.MISSING):
            say(f"scjax: warning: tile {number} is {tile.status.value}: {tile.fault}", quiet=as_json)
    if not rear and area is None:
        _say_if_short(map, length, as_json)
    files = [str(path), str(path.with_suffix(".png"))]
    if as_json:
        tiles = [{"status": tile.status.value, "attempts": tile.attempts, "fault": tile.fault} for tile in new]
        click.echo(json.dumps({"files": files, "tiles": tiles, "lanes": map.num_lanes, "agents": map.num_agents}))
    else:
        click.echo("\n".join(files))
    say(f"{len(new)} new tiles, {map.num_lanes} lanes, {map.num_agents} agents", quiet=as_json)


def _start_of(path: str) -> Scene | Map:
    """The map or first scene of a file."""
    from scjax.scene import Map

    content = read_content(path)
    return content if isinstance(content, Map) else scenes_of_content(content, path)[0]


def _with_rear(seed: int, scene: Any, prompt: str | None, path: str, sampling: dict[str, Any]) -> Map:
    from scjax.outpainting.rear import complete_rear
    from scjax.scene import Scene

    if not isinstance(scene, Scene):
        raise ValueError(f"{path}: --rear takes a forward scene, not a map")
    with progress_bar("tile"):
        return complete_rear(seed, scene, prompt, **sampling)


def _grown(
    seed: int, begin: Scene | Map | None, prompts: list[str] | None, ways: dict[str, Any], sampling: dict[str, Any]
) -> tuple[int, Map]:
    """The number of tiles that were there, and the map when it has grown; with a progress bar."""
    from tqdm import tqdm

    from scjax.outpainting.outpaint import outpaint_steps

    with tqdm(desc="tiles", unit="tile", disable=None) as bar:
        steps = outpaint_steps(seed, begin, prompts, **ways, **sampling)
        map = next(steps)
        first = len(map.tiles)
        for grown in steps:
            map = grown
            bar.update()
    return first, map


def _say_if_short(map: Map, length: float | None, quiet: bool) -> None:
    """A warning if the first route is shorter than requested."""
    from scjax.outpainting.outpaint import LENGTH
    from scjax.scene import route_line
    from scjax.scene.polyline import cumulative_length

    reached = float(cumulative_length(route_line(map, map.routes[0]))[-1]) if map.routes else 0.0
    if reached < (LENGTH if length is None else length):
        say(f"scjax: warning: the route is {reached:.0f} m long: no road goes on from there", quiet=quiet)
