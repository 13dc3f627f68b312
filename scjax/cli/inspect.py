"""scjax caption, plot and info: show what files and models hold."""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from scjax.cli.options import json_option, model_option

if TYPE_CHECKING:
    from scjax.scene import Scene


def read_scenes(path: str | Path) -> list[Scene]:
    """All scenes of an npz or JSON file that scjax wrote, without padding.

    Raises:
      ValueError: names the file and what is wrong with it.
    """
    from scjax.scene import io, unpadded

    readers = {".npz": io.load_npz, ".json": io.load_json}
    path = Path(path)
    if path.suffix not in readers:
        raise ValueError(f"{path}: scenes are read from {' and '.join(readers)} files, as scjax generate writes them")
    try:
        scene = readers[path.suffix](path)
    except FileNotFoundError as error:
        raise ValueError(f"{path}: there is no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read ({error})") from error
    if not scene.batch_shape:
        return [unpadded(scene)]
    return [unpadded(scene[k]) for k in range(scene.batch_shape[0])]


@click.command()
@click.argument("file")
@click.option(
    "--style",
    type=click.Choice(["short", "heads", "long"]),
    default="long",
    show_default=True,
    help="short: one or two sentences; heads: ROAD & CONTROL and AGENTS; long: a paragraph.",
)
@click.option("--seed", default=0, show_default=True, help="Random seed of the choice of words.")
@click.option("--json", "as_json", is_flag=True, help="Print facts and captions as JSON.")
def caption(file, style, seed, as_json) -> None:
    """Describes the scenes in FILE (.npz or .json) in English, by rule."""
    from scjax.language.captioner import write_caption
    from scjax.language.facts import extract_facts

    captions = []
    for scene in read_scenes(file):
        facts = extract_facts(scene)
        captions.append({"text": write_caption(facts, seed, style, drop=0.0), "facts": facts.to_json()})
    if as_json:
        click.echo(json.dumps(captions, indent=1))
        return
    for one in captions:
        click.echo(one["text"])


@click.command("plot")
@click.argument("file")
@click.option("--out", metavar="FILE", help="Picture to write. [default: FILE with the ending .png]")
@click.option("--speeds", is_flag=True, help="Also draw how far every agent moves in one second.")
def plot_command(file, out, speeds) -> None:
    """Draws the scenes in FILE (.npz or .json) from above."""
    from scjax.viz.grid import grid

    path = Path(out) if out else Path(file).with_suffix(".png")
    if path.suffix != ".png":
        raise click.UsageError(f"--out is {path}: pictures are .png files")
    grid(read_scenes(file), speeds=speeds, path=path)
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
