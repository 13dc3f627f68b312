"""scjax simulate: from a prompt or a file to moving traffic."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from scjax.cli.options import json_option, model_option, num_steps_option, seed_option
from scjax.cli.output import Clock, progress_bar, say, writable_folder
from scjax.cli.scene_files import read_content, scenes_of_content

if TYPE_CHECKING:
    from scjax.scene import Log, Map, Scene

_ANIMATIONS, _LOGS = (".gif", ".mp4"), (".npz",)


@click.command("simulate")
@click.argument("prompt", required=False)
@click.option("--start", metavar="FILE", help="Scene, map or recording to begin with, instead of PROMPT.")
@click.option("--step", type=click.IntRange(min=0), help="Step of a recording at which to begin. [default: 0]")
@click.option("--seconds", default=15.0, show_default=True, type=click.FloatRange(0.1, 600), help="Time to simulate.")
@click.option(
    "--behavior",
    default="idm",
    show_default=True,
    metavar="NAME",
    help="How agents move: idm, lane-changes, calm, adversarial, learned or constant-velocity.",
)
@click.option("--grow", is_flag=True, help="Let the map grow ahead of the ego, which a driving policy steers.")
@click.option("--heading-up", is_flag=True, help="Turn the animation so that the ego looks up.")
@click.option("--radius", type=click.FloatRange(5, 5000), help="Of the animation, from the middle to the edge, in m.")
@num_steps_option
@seed_option
@click.option(
    "--out",
    default="simulation.gif",
    show_default=True,
    metavar="FILE",
    help="Animation to write, .mp4 or .gif; the log is written beside it as .npz. With the ending .npz the log alone.",
)
@model_option
@json_option
def simulate_command(
    prompt, start, step, seconds, behavior, grow, heading_up, radius, num_steps, seed, out, model_folder, as_json
) -> None:
    """Lets traffic move: from words, a scene, a map or a recording to an animation.

    Vehicles follow their lanes, keep their distance, give way and obey the signals, which run through phases.
    Pedestrians and cyclists move too. Vehicles leave at the border of the map, and others enter.

    \b
    scjax simulate "a busy four-way intersection with signals" --out clip.mp4
    scjax simulate "a two-lane road in a town" --grow --seconds 60 --out drive.mp4
    scjax simulate --start Town01.xodr --behavior lane-changes --out town.gif
    scjax simulate --start recording.json.gz --step 10 --seconds 8 --out log.npz

    `scjax export` hands the log to simulators, `scjax plot log.npz --out clip.mp4` draws it again. MP4 files need
    pip install 'scjax[video]'.
    """
    path = _checked_out(out)
    if (prompt is None) == (start is None):
        raise click.UsageError("give a PROMPT or --start FILE, one of both")
    if step is not None and start is None:
        raise click.UsageError("--step is for a recording: give --start FILE too")
    writable_folder(path.parent)
    clock = Clock()
    with clock.part("scene"):
        from scjax.nn.startup import start_jax

        start_jax()
        from scjax.sim.behaviors import as_behavior

        model = as_behavior(behavior)
        source = _generated(prompt, seed, num_steps, model_folder) if prompt else _start_of(start, grow)
    with clock.part("traffic"):
        if grow:
            log = _grown(seed, source, prompt, seconds, model, model_folder, num_steps, quiet=as_json)
        else:
            from scjax.sim.simulate import simulate

            log = simulate(seed, source, seconds=seconds, behavior=model, step=step or 0)
    with clock.part("files"):
        files = _write(log, path, heading_up=heading_up, radius=radius)
    if as_json:
        seconds_of_log = float(log.timestamps[-1])
        summary = {"files": files, "objects": log.num_objects, "seconds": seconds_of_log, "times": clock.parts}
        click.echo(json.dumps(summary))
    else:
        click.echo("\n".join(files))
    say(f"{log.num_objects} objects over {log.timestamps[-1]:.1f} s: {clock.summary()}", quiet=as_json)


def _checked_out(out: str) -> Path:
    """The file to write.

    Raises:
      UsageError: its ending is of no known kind.
      ValueError: MP4 files cannot be written here.
    """
    path = Path(out)
    if path.suffix not in (*_ANIMATIONS, *_LOGS):
        raise click.UsageError(f"--out is {out}: animations are .mp4 or .gif files, logs .npz files")
    if path.suffix == ".mp4":
        from scjax.viz.video_file import video_suffix

        video_suffix(path)
    return path


def _generated(prompt: str, seed: int, num_steps: int | None, model: Any) -> Scene:
    """One scene for the prompt, repaired, since traffic needs lanes that meet."""
    import jax

    from scjax.generate.sample import sample_scenes

    options = {"model": model, "num_steps": num_steps, "repair": True}
    with progress_bar("scene") as progress:
        return sample_scenes(jax.random.key(seed), prompt, progress=progress, **options)[0].to_numpy()


def _start_of(path: str, grow: bool) -> Scene | Map | Log:
    """What a file holds; of several scenes the first. A map that shall grow is no recording.

    Raises:
      ValueError: names the file.
    """
    from scjax.scene import Log, Scene

    content = read_content(path)
    if isinstance(content, Log) and grow:
        raise ValueError(f"{path} is a recording, which does not grow: leave --grow out, or give a scene or a map")
    return scenes_of_content(content, path)[0] if isinstance(content, Scene) else content


def _grown(
    seed: int,
    source: Any,
    prompt: str | None,
    seconds: float,
    behavior: Any,
    model: Any,
    num_steps: int | None,
    *,
    quiet: bool,
) -> Log:
    """The log of a drive on a map that grows; with a progress bar."""
    from tqdm import tqdm

    from scjax.sim.drive import drive_steps
    from scjax.sim.policies import RoutePolicy

    options = {"model": model, "num_steps": num_steps}
    steps = drive_steps(seed, source, RoutePolicy(), behavior=behavior, seconds=seconds, grow=prompt or "", **options)
    result = None
    with tqdm(total=round(seconds), desc="drive", unit="s", disable=None) as bar:
        for result in steps:
            bar.update(round(float(result.log.timestamps[-1])) - bar.n)
    assert result is not None and result.map is not None
    say(f"{result.progress:.0f} m driven, {len(result.map.tiles)} tiles", quiet=quiet)
    if result.log.timestamps[-1] < seconds - 0.5:
        say("scjax: warning: the ego has left the map early: no road goes on from there", quiet=quiet)
    return result.log


def _write(log: Log, path: Path, *, heading_up: bool, radius: float | None) -> list[str]:
    """Writes the log, and the animation unless ``path`` is that of the log."""
    from scjax.scene import save_log, validate_log

    save_log(validate_log(log), path.with_suffix(".npz"))
    if path.suffix in _LOGS:
        return [str(path)]
    from scjax.viz import animate

    with progress_bar(path.name, "frame", delay=1.0) as progress:
        animate(log, path, heading_up=heading_up, radius=radius, progress=progress)
    return [str(path), str(path.with_suffix(".npz"))]
