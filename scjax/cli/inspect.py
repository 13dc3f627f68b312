"""scjax caption, plot and info: a look at files and at the model."""

from __future__ import annotations

import json
from pathlib import Path

import click


def read_scenes(path: str | Path) -> list:
    """All scenes of an npz or JSON file that scjax wrote.

    Raises:
      ValueError: naming the file and what is wrong with it.
    """
    from scjax.scene import io as scene_io
    from scjax.scene import unpadded

    path = Path(path)
    if path.suffix not in (".npz", ".json"):
        raise ValueError(f"{path}: scenes are read from .npz and .json files, as scjax generate writes them")
    try:
        scene = scene_io.load_npz(path) if path.suffix == ".npz" else scene_io.load_json(path)
    except FileNotFoundError as error:
        raise ValueError(f"{path}: there is no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read ({error})") from error
    if not scene.batch_shape:
        return [unpadded(scene)]
    return [unpadded(scene[k]) for k in range(scene.batch_shape[0])]


@click.command()
@click.argument("file")
@click.option("--style", type=click.Choice(["short", "heads", "long"]), default="long", show_default=True,
              help="One or two sentences; ROAD & CONTROL and AGENTS; a paragraph.")  # fmt: skip
@click.option("--seed", default=0, show_default=True, help="Of the words.")
@click.option("--json", "as_json", is_flag=True, help="Print facts and text as JSON.")
def caption(file, style, seed, as_json) -> None:
    """Says what the scenes in FILE (.npz or .json) show, by rule."""
    from scjax.language.captioner import write_caption
    from scjax.language.facts import extract_facts

    found = []
    for scene in read_scenes(file):
        facts = extract_facts(scene)
        found.append({"text": write_caption(facts, seed, style, drop=0.0), "facts": facts.to_json()})
    if as_json:
        click.echo(json.dumps(found, indent=1))
        return
    for one in found:
        click.echo(one["text"])


@click.command()
@click.argument("file")
@click.option("--out", metavar="FILE", help="Picture to write. [default: FILE with the ending .png]")
@click.option("--speeds", is_flag=True, help="Also draw how far everybody travels in one second.")
def plot(file, out, speeds) -> None:
    """Draws the scenes in FILE (.npz or .json) from above."""
    from scjax.viz.grid import grid

    path = Path(out) if out else Path(file).with_suffix(".png")
    if path.suffix != ".png":
        raise click.UsageError(f"--out is {path}: pictures are .png files")
    grid(read_scenes(file), speeds=speeds, path=path)
    click.echo(str(path))


@click.command()
@click.option("--model", "folder", metavar="DIR", help="A model folder instead of the one that ships.")
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def info(folder, as_json) -> None:
    """Tells what a model knows: its domains, sizes, text encoder and training."""
    import scjax
    from scjax.nn.functional import count

    model = scjax.load(folder)
    parts = {name: count(component.params) for name, component in model.components.items()}
    sizes = model.denoiser.config if "denoiser" in model.components else None
    told = {
        "scjax": scjax.__version__, "parameters": parts, "domains": list(model.domains),
        "text encoder": model.text_encoder or None, "prompts that need no encoder": list(model.prompts),
        "most lanes": sizes.max_lanes if sizes else None,
        "most agents": sizes.max_agents if sizes else None,
        "steps of training": model.notes.get("steps"),
    }  # fmt: skip
    if as_json:
        click.echo(json.dumps(told, indent=1))
        return
    for name, value in told.items():
        shown = ", ".join(f"{k} {v:,}" for k, v in value.items()) if isinstance(value, dict) else value
        shown = ("\n" + " " * 30).join(map(str, shown)) if isinstance(shown, list) else shown
        click.echo(f"{name:<30}{shown}")
