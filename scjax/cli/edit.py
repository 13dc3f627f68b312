"""scjax edit: agents of a scene are removed, moved and inserted, or parts of it drawn anew."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from scjax.cli.options import GenerationCommand, model_option, num_steps_option, out_option, seed_option
from scjax.cli.output import progress_bar, say, writable_folder, write_scene
from scjax.cli.place import formats_option
from scjax.cli.scene_files import read_content, scenes_of_content

if TYPE_CHECKING:
    from scjax.scene import Scene


class _Numbers(click.ParamType):
    """Numbers between commas, behind a word and a colon if ``word`` names one."""

    def __init__(self, name: str, counts: tuple[int, ...], word: str = ""):
        self.name, self._counts, self._word = name, counts, word

    def convert(self, value, param, ctx) -> tuple:
        """(word, numbers), or numbers alone; UsageError otherwise."""
        if not isinstance(value, str):
            return value
        head, colon, rest = value.rpartition(":")
        try:
            numbers = tuple(float(part) for part in rest.split(","))
        except ValueError:
            numbers = ()
        if bool(colon) != bool(self._word) or len(numbers) not in self._counts:
            self.fail(f"{value!r} is not of the form {self.name}", param, ctx)
        return (head, numbers) if self._word else numbers


class _Indices(click.ParamType):
    """Indices of agents between commas."""

    name = "N[,N...]"

    def convert(self, value, param, ctx) -> tuple[int, ...]:
        """The indices; UsageError otherwise."""
        try:
            return tuple(int(part) for part in value.split(",")) if isinstance(value, str) else value
        except ValueError:
            self.fail(f"{value!r} are no indices: write numbers with commas, as in 3,5", param, ctx)


@click.command("edit", cls=GenerationCommand)
@click.argument("file")
@click.argument("prompt", required=False)
@click.option("--scene", "number", type=click.IntRange(min=0), help="Which scene of FILE, counted from 0.")
@click.option("--remove", multiple=True, type=_Indices(), help="Remove agents.")
@click.option(
    "--move",
    "moves",
    multiple=True,
    type=_Numbers("N:X,Y[,DEGREES[,SPEED]]", (2, 3, 4), "agent"),
    help="Move an agent.",
)
@click.option(
    "--insert",
    "inserts",
    multiple=True,
    type=_Numbers("TYPE:X,Y[,DEGREES[,SPEED]]", (2, 3, 4), "type"),
    help="Insert a vehicle, pedestrian, cyclist or static object of usual size. [default speed: usual for the type]",
)
@click.option("--regenerate-agents", "again", multiple=True, type=_Indices(), help="Draw agents anew, given the rest.")
@click.option(
    "--regenerate-region",
    "region",
    type=_Numbers("X0,Y0,X1,Y1", (4,)),
    help="Draw all agents in a box anew, given the rest.",
)
@click.option("--region-agents", type=click.IntRange(0, 4096), help="Agents in the box then. [default: as before]")
@click.option("--region-lanes", is_flag=True, help="Draw lanes in the box anew too.")
@num_steps_option
@seed_option
@out_option
@formats_option
@model_option
def edit_command(
    file,
    prompt,
    number,
    remove,
    moves,
    inserts,
    again,
    region,
    region_agents,
    region_lanes,
    num_steps,
    seed,
    folder,
    formats,
    model_folder,
) -> None:
    """Edits one scene of FILE and writes it. Everything that no option names stays exactly as it is.

    Meters and degrees are in the frame of the scene: the ego, agent 0, is at 0,0 and looks along x. Every index means
    an agent of FILE, whatever else is edited. Options act in the order in which they are listed here: agents are
    removed, moved and inserted, then drawn anew. PROMPT, if there is one, is for what is drawn anew.

    \b
    scjax edit scene.json --remove 3 --remove 5 --move 4:10,2
    scjax edit scene.json --insert vehicle:12,-3.5,180 --insert pedestrian:8,6
    scjax edit scene.json --regenerate-agents 2,3 "two cyclists"
    scjax edit scene.json --regenerate-region 0,-16,32,16 --region-agents 6

    The ego is the frame: it is neither removed nor moved. A place that is taken is refused.
    """
    if region is None and (region_agents is not None or region_lanes):
        raise click.UsageError("--region-agents and --region-lanes are for --regenerate-region")
    draws = bool(again) or region is not None
    if prompt is not None and not draws:
        raise click.UsageError("PROMPT is for what is drawn anew: give --regenerate-agents or --regenerate-region")
    if not (draws or remove or moves or inserts):
        raise click.UsageError("there is nothing to edit: give --remove, --move, --insert or --regenerate-...")
    out = writable_folder(folder)
    before = _scene(file, number)
    scene, rows = _edit_by_hand(before, [row for some in remove for row in some], moves, inserts)
    if draws:
        options = {"model": model_folder, "num_steps": num_steps}
        again = [_row(rows, agent) for some in again for agent in some]
        box = None if region is None else (region, region_agents, region_lanes)
        scene = _draw_anew(scene, again, box, prompt, seed, options)
    files = write_scene(scene, out, f"{Path(file).name.partition('.')[0]}-edited", formats)
    click.echo("\n".join(map(str, files)))
    say(f"{int(before.num_agents)} agents before, {int(scene.num_agents)} now")


def _scene(file: str, number: int | None) -> Scene:
    scenes = scenes_of_content(read_content(file), file)
    if number is None and len(scenes) > 1:
        raise click.UsageError(f"{file} holds {len(scenes)} scenes: say which with --scene")
    if (number or 0) >= len(scenes):
        raise click.UsageError(f"{file} holds {len(scenes)} scenes, counted from 0: there is no scene {number}")
    return scenes[number or 0]


def _edit_by_hand(scene: Scene, remove: list[int], moves: Any, inserts: Any) -> tuple[Scene, dict[int, int]]:
    """The scene, and where every agent of the file is in it that was not removed."""
    from scjax.scene.edit import insert_agent, move_agent, remove_agents

    kept = [row for row in range(len(scene.agents)) if row not in remove]
    rows = {agent: row for row, agent in enumerate(kept)}
    scene = remove_agents(scene, remove)
    for agent, (x, y, *more) in moves:
        if not agent.isdecimal():
            raise click.UsageError(f"--move: {agent!r} is no index of an agent")
        scene = move_agent(scene, _row(rows, int(agent)), x, y, **_heading_and_speed(more))
    for kind, (x, y, *more) in inserts:
        scene = insert_agent(scene, kind, x, y, **_heading_and_speed(more))
    return scene, rows


def _row(rows: dict[int, int], agent: int) -> int:
    if agent not in rows:
        raise click.UsageError(f"agent {agent} is not there, or was removed: FILE has agents 0 to {max(rows)}")
    return rows[agent]


def _heading_and_speed(numbers: list[float]) -> dict[str, Any]:
    heading = {"heading": math.radians(numbers[0])} if numbers else {}
    return heading | ({"speed": numbers[1]} if len(numbers) > 1 else {})


def _draw_anew(
    scene: Scene, again: list[int], box: tuple | None, prompt: str | None, seed: int, options: dict[str, Any]
) -> Scene:
    """The scene with agents drawn anew, and then a box: its corners, its number of agents, and whether lanes too."""
    import jax

    from scjax.generate.edit import regenerate_agents, regenerate_region
    from scjax.nn.startup import start_jax

    start_jax()
    key = jax.random.key(seed)
    if again:
        with progress_bar("agents") as progress:
            scene = regenerate_agents(key, scene, again, prompt, repair=True, progress=progress, **options)
    if box is None:
        return scene
    region, number, lanes = box
    options |= {"repair": True, "num_agents": number, "lanes": lanes}
    with progress_bar("region") as progress:
        return regenerate_region(jax.random.fold_in(key, 1), scene, region, prompt, progress=progress, **options)
