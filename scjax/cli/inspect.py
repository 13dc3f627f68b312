"""scjax caption, plot and info: show what files and models hold."""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path

import click

from scjax.cli.options import json_option, model_option, seed_option
from scjax.cli.output import writable_folder
from scjax.cli.scene_files import read_scenes, strict_option

MAX_PANELS = 400
"""Scenes in one picture."""


@click.command()
@click.argument("file")
@click.option(
    "--style",
    help="Way of writing English, such as terse, everyday or engineer; an unknown one is answered with the list. "
    "[default: caption]",
)
@click.option("--language", default="en", show_default=True, help='Code of a language, such as "de".')
@seed_option
@strict_option
@click.option("--json", "as_json", is_flag=True, help="Print texts and the requests that they make as JSON.")
def caption(file, style, language, seed, strict, as_json) -> None:
    """Describes the scenes in FILE as people do. Another --seed says other things in other words.

    FILE holds scenes (.npz or .json) or a recording (.json.gz), of which the scene around its first pose is taken.
    """
    import numpy as np

    from scjax.language.attributes.table import measure_attributes
    from scjax.language.grammar.compose import compose

    style, rng = style or ("caption" if language == "en" else "languages"), np.random.default_rng(seed)
    captions = [
        compose(measure_attributes(scene), rng, style=style, language=language)
        for scene in read_scenes(file, strict=strict)
    ]
    if as_json:
        names = ("text", "request", "style", "language")
        content = [{name: getattr(one, name) for name in names} for one in captions]
        click.echo(json.dumps(content, indent=1, ensure_ascii=False))
        return
    for one in captions:
        click.echo(one.text)


@click.command("plot")
@click.argument("file")
@click.option("--out", metavar="FILE", help="Picture to write. [default: FILE with the ending .png]")
@click.option("--speeds", is_flag=True, help="Also draw how far every agent moves in one second.")
@strict_option
def plot_command(file, out, speeds, strict) -> None:
    """Draws the scenes in FILE from above.

    FILE holds scenes (.npz or .json) or a recording (.json.gz), of which the scene around its first pose is taken.
    """
    from scjax.viz.grid import grid

    path = Path(out) if out else Path(file.removesuffix(".gz")).with_suffix(".png")
    if path.suffix != ".png":
        raise click.UsageError(f"--out is {path}: pictures are .png files")
    scenes = read_scenes(file, strict=strict)
    if len(scenes) > MAX_PANELS:
        raise ValueError(f"{file} holds {len(scenes)} scenes: a picture shows {MAX_PANELS} at most, split the file")
    writable_folder(path.parent)
    grid(scenes, speeds=speeds, path=path)
    click.echo(str(path))


@click.command()
@model_option
@json_option
def info(model_folder, as_json) -> None:
    """Shows the domains, sizes, text encoder and training of a model."""
    from scjax.generate.model import load_model
    from scjax.nn.functional import count

    model = load_model(model_folder)
    parts = {name: count(component.params) for name, component in model.components.items()}
    sizes = model.denoiser.config if "denoiser" in model.components else None
    properties = {
        "scjax": importlib.metadata.version("scjax"),
        "parameters": parts,
        "domains": list(model.domains),
        "text encoder": model.text_encoder or None,
        "prompts that need no encoder": list(model.prompts),
        "most lanes": sizes.max_lanes if sizes else None,
        "most agents": sizes.max_agents if sizes else None,
        "steps of training": model.notes.get("steps"),
    }
    if as_json:
        click.echo(json.dumps(properties, indent=1))
        return
    for name, value in properties.items():
        shown = ", ".join(f"{k} {v:,}" for k, v in value.items()) if isinstance(value, dict) else value
        shown = ("\n" + " " * 30).join(map(str, shown)) if isinstance(shown, list) else shown
        click.echo(f"{name:<30}{shown}")


@click.command()
@click.argument("form", type=click.Choice(["scene", "recording"]))
def schema(form) -> None:
    """Prints the JSON Schema of a form of files: a scene (.json) or a recording (.json.gz).

    docs/scene-json.md explains both.
    """
    from scjax.data.readers.scene_json import recording_schema
    from scjax.scene.document import json_schema
    from scjax.scene.scene_document import SceneFile

    content = json_schema(SceneFile) if form == "scene" else recording_schema()
    click.echo(json.dumps(content, indent=1))
