"""scjax place: traffic on the lanes of a file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from scjax.cli.options import (
    GenerationCommand,
    best_of_option,
    json_option,
    model_option,
    num_steps_option,
    out_option,
    repair_option,
    seed_option,
)
from scjax.cli.output import FORMATS, Clock, progress_bar, say, slug, writable_folder, write_scene
from scjax.cli.plot import Place
from scjax.cli.scene_files import read_content, scenes_of_content
from scjax.cli.scene_results import scene_report

if TYPE_CHECKING:
    from scjax.generate.place import At
    from scjax.scene import Map, Scene

_CHUNK = 32
"""Scenes in a call."""

formats_option = click.option(
    "--format",
    "formats",
    multiple=True,
    default=("png", "json"),
    show_default=True,
    type=click.Choice(FORMATS),
    help="File format; repeat the option for several.",
)


class _Input(NamedTuple):
    """Scenes to place traffic in; the map that they are a window of, and where, if FILE is one."""

    scenes: list[Scene]
    map: Map | None
    at: At | None


@click.command("place", cls=GenerationCommand)
@click.argument("file")
@click.argument("prompt", required=False)
@click.option("--at", type=Place(), help="The place of the map, and where the ego there looks (0: to +x).")
@click.option("--agent", metavar="ID", help="The agent of the map or recording that is the ego, instead of a place.")
@click.option("--step", type=click.IntRange(min=0), help="Step of a recording, for --at and --agent. [default: 0]")
@click.option("--ego-speed", type=click.FloatRange(0, 70), help="Speed of the ego at a place in m/s. [default: 5]")
@click.option(
    "--agents",
    type=click.IntRange(1, 4096),
    help="Number of agents, with the ego and those that stay. [default: drawn]",
)
@click.option("--keep-agents/--replace-agents", default=True, show_default=True, help="What becomes of agents in FILE.")
@click.option("-n", "num_scenes", default=1, show_default=True, type=click.IntRange(1, 1000), help="Scenes to draw.")
@best_of_option
@repair_option
@num_steps_option
@click.option("--negative", metavar="PROMPT", help="Text that the scenes should not show.")
@click.option("--domain", help="Kind of place; `scjax info` lists them. [default: of similar lanes]")
@seed_option
@out_option
@formats_option
@click.option("--map-out", metavar="FILE", help="Also write the map with its traffic, .npz or .json.")
@model_option
@json_option
def place_command(
    file,
    prompt,
    at,
    agent,
    step,
    ego_speed,
    agents,
    keep_agents,
    num_scenes,
    negative,
    domain,
    seed,
    folder,
    formats,
    map_out,
    model_folder,
    as_json,
    **sampling,
) -> None:
    """Places traffic on the lanes of FILE, as PROMPT says if there is one, and writes the scenes.

    FILE holds scenes, or a map or recording in any format that scjax plot reads. Of a map the 64 m around --at or
    --agent are taken, by default around its first vehicle or a place on a lane. Lanes, lights and the agents that are
    there stay exactly as they are; --replace-agents leaves only the ego.

    \b
    scjax place Town01.xodr --at 120,-2,90 "five vehicles, two of them parked"
    scjax place USA_US101-3_3_T-1.xml --agent 363 --replace-agents -n 4 --out scenes
    scjax place scene.json "two pedestrians" --agents 12
    scjax place Town01.xodr --at 120,-2,90 --map-out town.json

    What PROMPT says about roads is of no effect: the lanes are given. Numbers of vehicles hold; other parts hold where
    these lanes allow it. Files are named by FILE, prompt, seed and number.
    """
    if at is not None and agent is not None:
        raise click.UsageError("give either --at or --agent")
    if map_out is not None and ((at is None and agent is None) or num_scenes > 1):
        raise click.UsageError("--map-out is for one scene (-n 1) at a place of a map: give --at or --agent")
    if map_out is not None and Path(map_out).suffix not in (".npz", ".json"):
        raise click.UsageError(f"--map-out is {map_out}: maps are .npz or .json files")
    out = writable_folder(folder)
    content = read_content(file)
    clock = Clock()
    with clock.part("start"):
        from scjax.generate.conditions import Condition
        from scjax.generate.model import load_model
        from scjax.generate.readings import read_prompts
        from scjax.nn.startup import start_jax

        start_jax()
        model = load_model(model_folder)
    given = _input(content, file, agent if at is None else at, step, ego_speed)
    condition = Condition(prompt=prompt, negative_prompt=negative, domain=domain)
    (condition,) = read_prompts([condition], model).conditions
    options = {"num_agents": agents, "keep_agents": keep_agents, "model": model, **sampling}
    name = slug(f"{Path(file).name.partition('.')[0]} {prompt or ''}".strip())
    results = []
    for number, scene in enumerate(_placed(given.scenes * num_scenes, condition, seed, options, clock)):
        with clock.part("files"):
            files = write_scene(scene, out, f"{name}-{seed}-{number}", formats)
            if map_out is not None:
                files.append(_write_map(given, scene, map_out, keep_agents))
        report = {"file": file, "prompt": prompt, "seed": seed, "number": number, "files": [str(one) for one in files]}
        results.append(report | scene_report(scene, condition.attributes))
        if not as_json:
            click.echo("\n".join(report["files"]))
    if as_json:
        click.echo(json.dumps({"scenes": results, "seconds": clock.parts}, indent=1))
    say(f"{len(results)} scenes: {clock.summary()}", quiet=as_json)


def _input(content: Any, file: str, at: Any, step: int | None, ego_speed: float | None) -> _Input:
    """What is in a file, at a place in meters and degrees or around an agent."""
    if at is None:
        if step is not None or ego_speed is not None:
            raise click.UsageError("--step and --ego-speed are for --at and --agent")
        return _Input(scenes_of_content(content, file), None, None)
    import numpy as np

    from scjax.data.imports import map_of_content
    from scjax.generate.place import EGO_SPEED, window_of_map

    if not isinstance(at, str):
        at = (*at[:2], *(float(np.deg2rad(degrees)) for degrees in at[2:]))
    map = map_of_content(content, file, step or 0)
    return _Input([window_of_map(map, at, EGO_SPEED if ego_speed is None else ego_speed)], map, at)


def _placed(scenes: list[Scene], condition: Any, seed: int, options: dict[str, Any], clock: Clock) -> Iterator[Scene]:
    """The scenes with traffic, under a progress bar."""
    import jax

    from scjax.generate.place import place_traffic
    from scjax.generate.sample import part_of

    key, starts = jax.random.key(seed), range(0, len(scenes), _CHUNK)
    with progress_bar("scenes") as progress:
        for number, start in enumerate(starts):
            own_key = jax.random.fold_in(key, start) if start else key
            part, some = part_of(progress, number, len(starts)), scenes[start : start + _CHUNK]
            with clock.part("scenes"):
                placed = place_traffic(own_key, some, condition, progress=part, **options)
            yield from placed


def _write_map(given: _Input, scene: Scene, path: str, keep_agents: bool) -> Path:
    from scjax.generate.place import traffic_in_map
    from scjax.scene import save_map

    assert given.map is not None
    num_known = len(given.scenes[0].agents) if keep_agents else 1
    writable_folder(Path(path).parent)
    save_map(traffic_in_map(given.map, given.at, scene, num_known, keep_agents=keep_agents), path)
    return Path(path)
