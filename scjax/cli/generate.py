"""scjax generate: scenes for prompts, in files."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from scjax.cli.options import (
    GenerationCommand,
    LateHelp,
    best_of_option,
    json_option,
    model_option,
    num_steps_option,
    out_option,
    repair_option,
    seed_option,
)
from scjax.cli.output import FORMATS, Clock, say, slug, writable_folder, write_scene

if TYPE_CHECKING:
    from scjax.scene import Scene


def _guidance_help() -> str:
    from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE

    return (
        "Guidance scale: higher follows the prompt more closely, 1 is no guidance. "
        f"[default: {DEFAULT_GUIDANCE_SCALE:g}]"
    )


def _sampler_help() -> str:
    from scjax.diffusion.defaults import DEFAULT_SAMPLER
    from scjax.diffusion.samplers import SAMPLERS

    return (
        f"{', '.join(SAMPLERS)}; euler and heun are for rectified flows. "
        f"[default: {DEFAULT_SAMPLER['velocity']}; rectified flow: {DEFAULT_SAMPLER['flow']}]"
    )


def _known_sampler(ctx: click.Context, option: click.Parameter, name: str | None) -> str | None:
    if name is not None:
        from scjax.diffusion.samplers import SAMPLERS

        if name not in SAMPLERS:
            raise click.BadParameter(f"{name!r} is not one of {', '.join(SAMPLERS)}")
    return name


@click.command(cls=GenerationCommand)
@click.argument("prompts", nargs=-1, required=True, metavar="PROMPT...")
@click.option("-n", "num_scenes", default=1, show_default=True, type=click.IntRange(1, 1000), help="Scenes per prompt.")
@best_of_option
@repair_option
@num_steps_option
@click.option("--guidance", type=click.FloatRange(-1000, 1000), cls=LateHelp, late_help=_guidance_help)
@click.option("--sampler", metavar="NAME", callback=_known_sampler, cls=LateHelp, late_help=_sampler_help)
@click.option(
    "--temperature",
    type=click.FloatRange(0, 100, min_open=True),
    help="Scale of the noise: lower gives cleaner and less varied scenes. [default: the model's]",
)
@click.option(
    "--energy-guidance/--no-energy-guidance",
    default=None,
    help="While sampling, take gradient steps towards closed lane connections, boxes that do not overlap and vehicles "
    "on lanes. [default: the model's]",
)
@click.option(
    "--agents",
    type=click.IntRange(1, 4096),
    help="Number of agents, the ego included. [default: drawn from the prompt]",
)
@click.option("--lanes", type=click.IntRange(1, 4096), help="Number of lanes. [default: drawn from the prompt]")
@click.option("--negative", metavar="PROMPT", help="Text that the scenes should not show.")
@click.option("--domain", help="Kind of place; `scjax info` lists them. [default: drawn from the model's data]")
@seed_option
@out_option
@click.option(
    "--format",
    "formats",
    multiple=True,
    default=("png",),
    show_default=True,
    type=click.Choice(FORMATS),
    help="File format; repeat the option for several.",
)
@model_option
@json_option
def generate(
    prompts,
    num_scenes,
    best_of,
    repair,
    num_steps,
    guidance,
    sampler,
    temperature,
    energy_guidance,
    agents,
    lanes,
    negative,
    domain,
    seed,
    folder,
    formats,
    model_folder,
    as_json,
) -> None:
    """Generates scenes for every PROMPT and writes them to files, named by prompt, seed and number.

    \b
    scjax generate "a busy four-way intersection with a red light, five vehicles and two pedestrians"
    scjax generate "a motorway with a lane that ends" -n 4 --format png --format json --out scenes
    scjax generate "a roundabout" --best-of 32

    Every scene is the best of several candidates (--best-of), each repaired after sampling (--no-repair leaves them as
    sampled). Counts that are given (--agents, --lanes) win over the prompt. Prompts that do not ship with the model
    need the text encoder, which is downloaded once; without a network, set SCJAX_TEXT_ENCODER (see the README).
    """
    out = writable_folder(folder)
    clock = Clock()
    with clock.part("start"):
        import jax

        from scjax.generate.best_of import prompt_warnings
        from scjax.generate.conditions import Condition
        from scjax.generate.model import load_model
        from scjax.generate.sample import sample_scenes
        from scjax.nn.startup import start_jax

        start_jax()
        model = load_model(model_folder)
    conditions = [
        Condition(prompt=prompt, negative_prompt=negative, num_agents=agents, num_lanes=lanes, domain=domain)
        for prompt in prompts
    ]
    for warning in (warning for condition in conditions for warning in prompt_warnings(condition)):
        say(f"scjax: warning: {warning}")
    with clock.part("scenes"):
        scenes = sample_scenes(
            jax.random.key(seed),
            conditions,
            model=model,
            num_scenes=num_scenes,
            num_steps=num_steps,
            guidance=guidance,
            sampler=sampler,
            best_of=best_of,
            repair=repair,
            temperature=temperature,
            energy_guidance=energy_guidance,
        )
    with clock.part("files"):
        results, numbers = [], Counter()
        for i, scene in enumerate(scenes):
            prompt = prompts[i // num_scenes]
            results.append(_write_result(scene, prompt, seed, numbers[prompt], out, formats))
            numbers[prompt] += 1  # a prompt that is given twice has twice as many scenes
    if as_json:
        click.echo(json.dumps({"scenes": results, "seconds": clock.parts}, indent=1))
    else:
        for result in results:
            click.echo("\n".join(result["files"]))
    say(f"{len(scenes)} scenes: {clock.summary()}", quiet=as_json)


def _write_result(
    scene: Scene, prompt: str, seed: int, number: int, out: Path, formats: Sequence[str]
) -> dict[str, Any]:
    """Writes one scene and says what it holds."""
    from scjax.language.facts import extract_facts

    files = write_scene(scene, out, f"{slug(prompt)}-{seed}-{number}", formats)
    return {
        "prompt": prompt,
        "seed": seed,
        "number": number,
        "files": [str(path) for path in files],
        "lanes": int(scene.num_lanes),
        "agents": int(scene.num_agents),
        "facts": extract_facts(scene).to_json(),
    }
