"""scjax generate: scenes for prompts, in files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

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
from scjax.cli.output import FORMATS, Clock, progress_bar, say, writable_folder
from scjax.cli.picture_input import PictureInput, check_reads_pictures, picture_options, read_picture
from scjax.cli.prompt_lists import ListedPrompt, read_prompt_list
from scjax.cli.scene_results import SceneFiles

if TYPE_CHECKING:
    from scjax.generate.scene_spec import SceneSpec

CHUNK = 128
"""Prompts that are sampled together, in batches by size. Scenes depend on the place of their prompt in the file."""


def _guidance_help() -> str:
    from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE

    return (
        "Guidance scale: higher follows the prompt more closely, 1 is no guidance. "
        f"[default: the model's, else {DEFAULT_GUIDANCE_SCALE:g}]"
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
@click.argument("prompts", nargs=-1, metavar="PROMPT...")
@click.option(
    "--prompts",
    "prompt_file",
    metavar="FILE",
    help='Prompts of a file, one a line: {"id": "a1", "prompt": "a roundabout"}. Their scenes go to DIR/ID/; what is '
    "there is not generated again.",
)
@click.option("--no-prompt", is_flag=True, help="Scenes of no request, also by models that read no prompts.")
@picture_options
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
    prompt_file,
    no_prompt,
    image,
    depth,
    camera,
    camera_name,
    agents,
    lanes,
    negative,
    domain,
    seed,
    folder,
    formats,
    model_folder,
    as_json,
    **sampling,
) -> None:
    """Generates scenes for every PROMPT, or a picture, and writes them to files named by prompt, seed and number.

    \b
    scjax generate "a busy four-way intersection with a red light, five vehicles and two pedestrians"
    scjax generate "a motorway with a lane that ends" -n 4 --format png --format json --out scenes
    scjax generate "a roundabout" --best-of 32
    scjax generate --image road.jpg --camera dashcam "two cyclists"

    Every scene is the best of several candidates (--best-of), each repaired after sampling (--no-repair leaves them as
    sampled). Counts that are given (--agents, --lanes) win over the prompt. Prompts of your own need
    a text encoder (91 MB), which is downloaded once; without a network, name its folder in SCJAX_MULTILINGUAL_ENCODER
    (docs/generate.md). `scjax read` shows what is understood of a prompt.
    """
    picture = read_picture(image, depth, camera, camera_name)
    entries = _entries(prompts, prompt_file, no_prompt, picture)
    out = writable_folder(folder)
    clock = Clock()
    with clock.part("start"):
        import jax

        from scjax.generate.conditions import Condition
        from scjax.generate.model import load_model
        from scjax.generate.sample import sample_scenes
        from scjax.generate.scene_spec import specify_scenes
        from scjax.nn.startup import start_jax

        start_jax()
        model = load_model(model_folder)
        if picture is not None:
            check_reads_pictures(model)

    given = {"negative_prompt": negative, "num_agents": agents, "num_lanes": lanes, "domain": domain}
    given |= {} if picture is None else picture.fields(model)

    files, key, results = SceneFiles(out, seed, sampling["num_scenes"], formats, picture), jax.random.key(seed), []
    for number, some in [(None, entries)] if prompt_file is None else _parts(entries):
        if number is not None and all(files.is_complete(entry) for entry in some):
            continue
        with clock.part("scenes"):
            conditions = [Condition(prompt=entry.prompt, **given) for entry in some]
            specs = specify_scenes(conditions, model)
            for entry, spec in zip(some, specs, strict=True):
                _say_understood(entry.id, spec, quiet=as_json)
            own_key = key if number is None else jax.random.fold_in(key, number)
            with progress_bar("scenes") as progress:
                scenes = sample_scenes(own_key, specs, model=model, progress=progress, **sampling)
        with clock.part("files"):
            results += files.write(some, [spec.attributes for spec in specs], scenes)
    if as_json:
        click.echo(json.dumps({"scenes": results, "seconds": clock.parts}, indent=1))
    else:
        for result in results:
            click.echo("\n".join(result["files"]))
    say(f"{len(results)} scenes: {clock.summary()}", quiet=as_json)


def _parts(entries: Sequence[ListedPrompt]) -> Iterator[tuple[int, Sequence[ListedPrompt]]]:
    """(number, entries) of every part of ``CHUNK`` prompts, under a progress bar."""
    from tqdm import tqdm

    with tqdm(total=len(entries), unit="prompt", disable=len(entries) <= CHUNK) as bar:
        for number, start in enumerate(range(0, len(entries), CHUNK)):
            some = entries[start : start + CHUNK]
            yield number, some
            bar.update(len(some))


def _say_understood(id: str, spec: SceneSpec, *, quiet: bool) -> None:
    """Says what was understood of a prompt without an id, unless ``quiet``, and what will not come true."""
    from scjax.language.attributes.shown import shown_request

    if spec.attributes and not id:
        say(f"understood: {shown_request(spec.attributes)}", quiet=quiet)
    for warning in spec.warnings:
        say(f"scjax: warning: {id}{': ' if id else ''}{warning}")


def _entries(
    prompts: Sequence[str], prompt_file: str | None, no_prompt: bool, picture: PictureInput | None
) -> list[ListedPrompt]:
    """What to generate; UsageError where the arguments do not fit together."""
    if no_prompt and (prompts or prompt_file is not None):
        raise click.UsageError("--no-prompt excludes PROMPT and --prompts: leave out one of them")
    if picture is not None and prompt_file is not None:
        raise click.UsageError("--image and --prompts exclude each other: give the picture with a PROMPT, or without")
    if no_prompt or (picture is not None and not prompts):
        return [ListedPrompt("", None)]
    if bool(prompts) == (prompt_file is not None):
        raise click.UsageError(
            "give PROMPT, --image FILE, --prompts FILE or --no-prompt; a prompt and a picture may come together"
        )
    return read_prompt_list(prompt_file) if prompt_file is not None else [ListedPrompt("", one) for one in prompts]
