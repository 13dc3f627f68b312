"""scjax caption, info and schema: say what files and models hold."""

from __future__ import annotations

import importlib.metadata
import json

import click

from scjax.cli.options import json_option, model_option, seed_option
from scjax.cli.scene_files import read_scenes, strict_option


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

    FILE holds scenes, or a recording or map in any format that scjax plot reads, of which the scene around its first
    pose is taken.
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
@click.argument("form", type=click.Choice(["scene", "recording", "map", "rig"]))
def schema(form) -> None:
    """Prints the JSON Schema of a form of files: a scene, map or rig of cameras (.json), or a recording (.json.gz).

    docs/scene-json.md, docs/maps.md and docs/camera.md explain them.
    """
    from scjax.camera.rig_file import RigDocument
    from scjax.data.readers.scene_json import recording_schema
    from scjax.scene.document import json_schema
    from scjax.scene.map_io import MapFile
    from scjax.scene.scene_document import SceneFile

    documents = {"scene": SceneFile, "map": MapFile, "rig": RigDocument}
    content = recording_schema() if form == "recording" else json_schema(documents[form])
    click.echo(json.dumps(content, indent=1))
