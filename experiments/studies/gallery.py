"""Pictures of the scenes of a list of prompts, with what each prompt asks for and each scene shows.

    python -m experiments.studies.gallery --prompts=experiments/prompts/free_form.txt --out=docs/results/gallery

The prompts are a text file with one per line, or JSON (lists of texts, or of objects with a "prompt"). The reader of
prompts says what they ask for, the table of attributes what scenes show. Scenes are as sampled; with --best-of 8 they
are selected and repaired as by ``scjax generate``, and the page says so. --remarks is a text file with lines
"NUMBER: what somebody saw in the picture of that prompt", which the page repeats.

Writes OUT.md, OUT.json and a folder OUT with a picture per prompt.
"""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
from PIL import Image
from tqdm import tqdm

import scjax
from experiments.studies.page import command_line, script_parser, table_lines, write_page
from scjax.generate.readings import read_requests
from scjax.language.attributes.table import measure_attributes, score_attributes
from scjax.nn.startup import start_jax
from scjax.viz.grid import grid


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.gallery", __doc__)
    add = parser.add_argument
    add("--model", help="model folder (default: the model of the package)")
    add("--prompts", required=True, type=Path, help="file of prompts")
    add("--out", type=Path, default=Path("gallery"), help="path without ending (default %(default)s)")
    add("--samples", type=int, default=3, help="scenes per prompt (default %(default)s)")
    add("--guidance", type=float, help="guidance scale (default: the model's)")
    add("--num-steps", type=int, help="sampling steps (default: the sampler's own)")
    add("--seed", type=int, default=0)
    add("--best-of", type=int, default=1, metavar="K", help="samples per scene; above 1 the best is repaired and kept")
    add("--numbers-only", action="store_true", help="name prompts by number, for texts that must not be repeated")
    add("--remarks", type=Path, help="file of what was seen in the pictures")
    args = parser.parse_args(arguments)
    try:
        remarks = read_remarks(args.remarks) if args.remarks else {}
        results = sample_gallery(args)
        for number, result in enumerate(results, 1):
            result["remark"] = remarks.get(number, "")
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.gallery: {error}")
    write_page(args.out, markdown(results, args, command_line("gallery", arguments)), results)
    print(args.out.with_name(f"{args.out.name}.md"))


def sample_gallery(args: argparse.Namespace) -> list[dict[str, Any]]:
    """Samples and draws all prompts.

    Returns:
      Per prompt: its text ("" with --numbers-only), picture, warnings, and what each scene shows and meets.

    Raises:
      ValueError: the file holds no prompts, or the model cannot read them.
    """
    prompts = read_prompts(args.prompts)
    model = scjax.load(args.model)
    args.out.mkdir(parents=True, exist_ok=True)
    results = []
    for number, prompt in enumerate(tqdm(prompts, "prompts", disable=None), 1):
        condition = scjax.Condition(prompt=prompt)
        (read,), (unmet,), _ = read_requests([condition])
        with warnings.catch_warnings(record=True) as raised:
            warnings.simplefilter("always")
            scenes = scjax.sample(
                jax.random.fold_in(jax.random.key(args.seed), number),
                [condition],
                model=model,
                num_scenes=args.samples,
                num_steps=args.num_steps,
                guidance=args.guidance,
                best_of=args.best_of,
                repair=args.best_of > 1,
            )
        picture = args.out / f"prompt-{number:02d}.png"
        grid(scenes, columns=args.samples, path=picture, dpi=max(60, 180 // args.samples))
        reduce_colors(picture)
        messages = [*(str(one.message) for one in raised), *unmet]
        if args.numbers_only and messages:
            messages = ["the warning quotes the prompt"]
        results.append(
            {
                "prompt": "" if args.numbers_only else prompt,
                "picture": f"{args.out.name}/{picture.name}",
                "warnings": messages,
                "scenes": [_shown(scene, read.attributes) for scene in scenes],
            }
        )
    return results


def reduce_colors(path: Path, colors: int = 32) -> None:
    """Writes a picture again with a palette: a third of the size, edges of thin lines differ a little."""
    with Image.open(path) as image:  # median cut would merge the rare colors, which are those of agents
        image.convert("RGB").quantize(colors, Image.Quantize.MAXCOVERAGE, kmeans=2).save(path, optimize=True)


def _shown(scene: scjax.Scene, request: Mapping[str, Any]) -> dict[str, Any]:
    shows = measure_attributes(scene)
    layout, signal = (next(iter(shows[name]), "unknown") for name in ("layout", "signal"))
    counts = ", ".join(f"{shows[name]} {name}" for name in ("vehicles", "pedestrians", "cyclists"))
    misses = score_attributes(scene, request).misses
    return {
        "facts": f"{layout}; {counts}; light {signal}; events {', '.join(shows['event']) or 'none'}",
        "checks": {name: name not in misses for name in request},
    }


def markdown(results: Sequence[dict[str, Any]], args: argparse.Namespace, command: str) -> str:
    """The page: totals of all checks, then each prompt with its picture."""
    totals: dict[str, list[bool]] = {}
    for result in results:
        for scene in result["scenes"]:
            for name, shown in scene["checks"].items():
                totals.setdefault(name, []).append(shown)
    selection = "as sampled" if args.best_of == 1 else f"each the best of {args.best_of}, repaired"
    table = [[name, f"{sum(shown)} of {len(shown)}"] for name, shown in sorted(totals.items())]
    lines = [
        "# Gallery",
        "",
        f"`{command}`",
        "",
        f"Scenes per prompt: {args.samples}, {selection}, seed {args.seed}. Prompts are read by a network.",
        "",
        *table_lines(["request", "scenes that meet it"], table),
        "",
    ]
    for number, result in enumerate(results, 1):
        title = textwrap.shorten(result["prompt"], 300)
        lines += [f"## {number}. {title}" if title else f"## {number}", "", f"![{number}]({result['picture']})", ""]
        lines += [*table_lines(["scene", "requests"], [_scene_cells(scene) for scene in result["scenes"]]), ""]
        lines += [f"Seen: {result['remark']}", ""] if result["remark"] else []
        lines += [line for message in result["warnings"] for line in (f"- warning: {message}", "")]
    return "\n".join(lines)


def _scene_cells(scene: dict[str, Any]) -> list[str]:
    checks = ", ".join(f"{name} {'yes' if shown else 'no'}" for name, shown in scene["checks"].items())
    return [scene["facts"], checks or "none read"]


def read_remarks(path: Path) -> dict[int, str]:
    """Number of a prompt -> what was seen.

    Raises:
      ValueError: a line has no number; names it.
    """
    remarks = {}
    for place, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        number, colon, text = line.partition(":")
        if not (colon and number.strip().isdecimal()):
            raise ValueError(f'{path}, line {place}: write "NUMBER: what was seen"')
        remarks[int(number)] = text.strip()
    return remarks


def read_prompts(path: Path) -> list[str]:
    """Prompts of a file.

    Raises:
      ValueError: the file holds none.
    """
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == ".json" else text.splitlines()
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: neither lines of text nor JSON ({error})") from error
    if isinstance(content, dict):
        content = [item for value in content.values() for item in (value if isinstance(value, list) else [value])]
    prompts = [text.strip() for text in map(_text, content) if text.strip()]
    if not prompts:
        raise ValueError(f"{path}: holds no prompts: write one per line")
    return prompts


def _text(item: object) -> str:
    """A text, the "prompt" of an object, or its "condition" if its "type" is "text" (as on the paper's page)."""
    if not isinstance(item, dict):
        return str(item)
    return item.get("prompt", "") or (item.get("condition", "") if item.get("type") == "text" else "")


if __name__ == "__main__":
    start_jax()
    main()
