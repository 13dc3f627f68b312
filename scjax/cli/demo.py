"""scjax demo: one picture of scenes for several prompts, without any network."""

from __future__ import annotations

import json
import sys

import click

from scjax.cli.output import CANDIDATES, PICK_HELP, Clock, say, slug, writable_folder, write_scene
from scjax.diffusion.defaults import DEFAULT_SAMPLER
from scjax.diffusion.samplers import DEFAULT_STEPS

PROMPTS = (
    "a busy four-way intersection with a red light, five vehicles and two pedestrians",
    "a T-intersection with several vehicles",
    "a straight road with three lanes in each direction, ten vehicles",
    "a curved road with one lane in each direction and a single vehicle",
    "a roundabout with a few vehicles",
    "a wrong-way driver on a motorway",
)
"""Their token features ship with the model."""


@click.command()
@click.option("--seed", default=0, show_default=True, help="Another seed, other scenes.")
@click.option("--steps", type=click.IntRange(2, 100), help="Sampling steps. [default: "
              f"{DEFAULT_STEPS['velocity'][DEFAULT_SAMPLER['velocity']]}]")  # fmt: skip
@click.option("--pick", default=CANDIDATES, show_default=True, type=click.IntRange(1, 100), help=PICK_HELP)
@click.option("--raw", is_flag=True, help="Scenes exactly as sampled: no lane smoothed, no joint closed, no box moved.")
@click.option("--out", "folder", default=".", show_default=True, metavar="DIR", help="Folder for the files.")
@click.option("--model", "model_folder", metavar="DIR", help="A model folder instead of the one that ships.")
@click.option("--json", "as_json", is_flag=True, help="Print what was made as JSON on stdout.")
def demo(seed, steps, pick, raw, folder, model_folder, as_json) -> None:
    """Draws a scene for each of some prompts and saves them in one labelled picture, and each as npz."""
    out = writable_folder(folder)
    clock = Clock()
    with clock.part("start"):
        import textwrap

        import jax

        import scjax
        from scjax.generate.best_of import make
        from scjax.generate.prompts import encode_prompts
        from scjax.generate.sample import bucket_of, with_counts
        from scjax.nn.startup import start_jax
        from scjax.viz.grid import grid

        start_jax()
        model = scjax.load(model_folder)
        told = encode_prompts([scjax.Condition(prompt=prompt) for prompt in PROMPTS], model)
    scenes, sizes = [], set()
    key = jax.random.key(seed)
    with click.progressbar(list(zip(PROMPTS, told, strict=True)), label="scenes", file=sys.stderr) as bar:
        for k, (prompt, condition) in enumerate(bar):
            own = jax.random.fold_in(key, k)
            (counted,) = with_counts(own, [condition], model=model)
            size = bucket_of(counted.num_agents or 1, counted.num_lanes or 1)
            first = "first scene of another size" if sizes else "first scene"
            with clock.part("later scenes" if size in sizes else f"{first} (with compiling)"):
                sizes.add(size)
                scenes += make(own, [prompt], [counted], model=model, pick=pick, raw=raw, steps=steps)
    with clock.part("files"):
        titles = ["\n".join(textwrap.wrap(prompt, 44)) for prompt in PROMPTS]
        picture = out / f"scjax-demo-{seed}.png"
        grid(scenes, columns=3, titles=titles, path=picture)
        files = [picture]
        for prompt, scene in zip(PROMPTS, scenes, strict=True):
            files += write_scene(scene, out, f"{slug(prompt)}-{seed}", ("npz",), None)
    if as_json:
        click.echo(json.dumps({"files": [str(path) for path in files], "seconds": clock.parts}, indent=1))
    else:
        click.echo(str(picture))
    say(f"{len(scenes)} scenes: {clock.told()}", quiet=as_json)
