"""scjax demo: one picture of scenes for several prompts, without any network access."""

from __future__ import annotations

import json
import textwrap

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
from scjax.cli.output import Clock, progress_bar, say, slug, writable_folder, write_scene

PROMPTS = (
    "a busy four-way intersection with a red light, five vehicles and two pedestrians",
    "a T-intersection with several vehicles",
    "a straight road with three lanes in each direction, ten vehicles",
    "a curved road with one lane in each direction and a single vehicle",
    "a roundabout with a few vehicles",
    "a wrong-way driver on a motorway",
)
"""What they ask for ships with the reader of prompts."""

_PADDED_SIZE = (16, 28)
"""(agents, lanes) that holds nearly all of these scenes, so that there is one set of programs to compile."""


@click.command(cls=GenerationCommand)
@best_of_option
@repair_option
@num_steps_option
@seed_option
@out_option
@model_option
@json_option
def demo(best_of, repair, num_steps, seed, folder, model_folder, as_json) -> None:
    """Generates one scene for each of six prompts, in one labeled picture and as npz files.

    What the prompts ask for ships with the reader, so no text encoder is needed. The first scene takes longest: its
    program has to be compiled.
    """
    out = writable_folder(folder)
    clock = Clock()
    with clock.part("start"):
        import jax

        from scjax.generate.conditions import Condition
        from scjax.generate.model import load_model
        from scjax.generate.sample import part_of, sample_scenes
        from scjax.nn.startup import start_jax
        from scjax.viz.grid import grid

        start_jax()
        model = load_model(model_folder)
    scenes = []
    with progress_bar("scenes") as progress:
        for i, prompt in enumerate(PROMPTS):
            with clock.part("later scenes" if scenes else "first scene (with compiling)"):
                scenes += sample_scenes(
                    jax.random.fold_in(jax.random.key(seed), i),
                    [Condition(prompt=prompt)],
                    model=model,
                    num_steps=num_steps,
                    best_of=best_of,
                    repair=repair,
                    padded_size=_PADDED_SIZE,
                    progress=part_of(progress, i, len(PROMPTS)),
                )
    with clock.part("files"):
        titles = ["\n".join(textwrap.wrap(prompt, 44)) for prompt in PROMPTS]
        picture = out / f"scjax-demo-{seed}.png"
        grid(scenes, columns=3, titles=titles, path=picture)
        files = [picture]
        for prompt, scene in zip(PROMPTS, scenes, strict=True):
            files += write_scene(scene, out, f"{slug(prompt)}-{seed}", ("npz",))
    if as_json:
        click.echo(json.dumps({"files": [str(path) for path in files], "seconds": clock.parts}, indent=1))
    else:
        click.echo(str(picture))
    say(f"{len(scenes)} scenes: {clock.summary()}", quiet=as_json)
