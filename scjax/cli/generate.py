"""scjax generate: scenes for prompts, in files."""

from __future__ import annotations

import json
from pathlib import Path

import click

from scjax.cli.output import CANDIDATES, FORMATS, PICK_HELP, Clock, say, slug, writable_folder, write_scene
from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE, DEFAULT_SAMPLER
from scjax.diffusion.samplers import DEFAULT_STEPS, SAMPLERS

_DEFAULT_STEPS = ", ".join(
    f"{name} {steps}" for name, steps in (DEFAULT_STEPS["flow"] | DEFAULT_STEPS["velocity"]).items()
)


@click.command()
@click.argument("prompts", nargs=-1, required=True, metavar="PROMPT...")
@click.option("-n", "number", default=1, show_default=True, type=click.IntRange(1, 1000), help="Scenes a prompt.")
@click.option(
    "--seed", default=0, show_default=True, help="Another seed, other scenes; the same seed, the same scenes."
)
@click.option("--sampler", type=click.Choice(list(SAMPLERS)), help="How noise becomes a scene; euler and heun are for "
              f"rectified flows. [default: {DEFAULT_SAMPLER['velocity']}; rectified flow: {DEFAULT_SAMPLER['flow']}]")  # fmt: skip
@click.option(
    "--steps", type=click.IntRange(2, 100), help=f"Sampling steps; fewer are faster. [default: {_DEFAULT_STEPS}]"
)
@click.option("--guidance", type=float, help="How closely the prompt is followed; 1 is not at all pushed. "
              f"[default: {DEFAULT_GUIDANCE_SCALE:g}]")  # fmt: skip
@click.option("--temperature", type=click.FloatRange(0, min_open=True), help="Scale of the noise; lower is tidier and "
              "less varied. [default: the model's]")  # fmt: skip
@click.option("--energy-guidance/--no-energy-guidance", "energy_guidance", default=None, help="Lead what is sampled to closed joints, boxes that "
              "do not overlap, and vehicles on lanes. "
              "[default: the model's]")  # fmt: skip
@click.option(
    "--agents", type=click.IntRange(1), help="Agents in the scene, the ego included. [default: as the prompt asks]"
)
@click.option("--lanes", type=click.IntRange(1), help="Lanes in the scene. [default: as the prompt asks]")
@click.option("--negative", help="What the scene shall not show.")
@click.option("--domain", help="Kind of place; `scjax info` lists them. [default: drawn]")
@click.option("--pick", default=CANDIDATES, show_default=True, type=click.IntRange(1, 100), help=PICK_HELP)
@click.option("--raw", is_flag=True, help="Scenes exactly as sampled: no lane smoothed, no joint closed, no box moved.")
@click.option("--out", "folder", default=".", show_default=True, metavar="DIR", help="Folder for the files.")
@click.option("--format", "formats", multiple=True, default=("png",), show_default=True, type=click.Choice(FORMATS),
              help="May be given several times.")  # fmt: skip
@click.option("--model", "model_folder", metavar="DIR", help="A model folder instead of the one that ships.")
@click.option("--json", "as_json", is_flag=True, help="Print what was made as JSON on stdout.")
def generate(
    prompts, number, seed, sampler, steps, guidance, temperature, energy_guidance, agents, lanes, negative, domain, pick,
    raw, folder, formats, model_folder, as_json,
) -> None:  # fmt: skip
    """Generates scenes for every PROMPT and writes them to files.

    \b
    scjax generate "a busy four-way intersection with a red light, five vehicles and two pedestrians"
    scjax generate "a motorway with a lane that ends" -n 4 --format png --format json --out scenes
    scjax generate "a roundabout" --pick 32

    Candidates are tidied as by scjax.scene.repair unless --raw, and the best of several is kept (--pick). Numbers
    that are given (--agents, --lanes) win over what a prompt says. Free text needs the text encoder, which is fetched
    once; see SCJAX_TEXT_ENCODER in the README for machines without a network.
    """
    out = writable_folder(folder)
    clock = Clock()
    with clock.part("start"):
        import jax

        import scjax
        from scjax.generate.best_of import make
        from scjax.generate.prompts import prompt_warnings
        from scjax.language.facts import extract_facts
        from scjax.nn.startup import start_jax

        start_jax()
        model = scjax.load(model_folder)
        conditions = [
            scjax.Condition(
                prompt=prompt, negative_prompt=negative, num_agents=agents, num_lanes=lanes, domain=domain
            )
            for prompt in prompts
        ]  # fmt: skip
    for condition in conditions:
        for warning in prompt_warnings(condition):
            say(f"scjax: warning: {warning}")
    with clock.part("text"):
        from scjax.generate.prompts import encode_prompts

        told = encode_prompts(conditions, model)
    with clock.part("scenes"):
        repeated = [(prompt, one) for prompt, one in zip(prompts, told, strict=True) for _ in range(number)]
        scenes = make(
            jax.random.key(seed), [prompt for prompt, _ in repeated], [one for _, one in repeated], model=model,
            pick=pick, raw=raw, sampler=sampler, steps=steps, guidance=guidance, temperature=temperature,
            energy_guidance=energy_guidance,
        )  # fmt: skip
    made = []
    with clock.part("files"):
        for k, scene in enumerate(scenes):
            prompt = prompts[k // number]
            name = f"{slug(prompt)}-{seed}-{k % number}"
            files = write_scene(scene, out, name, formats, title=None)
            facts = extract_facts(scene).to_json()
            made.append({"prompt": prompt, "seed": seed, "number": k % number, "files": [str(path) for path in files],
                         "lanes": int(scene.num_lanes), "agents": int(scene.num_agents), "facts": facts})  # fmt: skip
    if as_json:
        click.echo(json.dumps({"scenes": made, "seconds": clock.parts}, indent=1))
    else:
        for one in made:
            for path in one["files"]:
                click.echo(str(Path(path)))
    say(f"{len(scenes)} scenes: {clock.told()}", quiet=as_json)
