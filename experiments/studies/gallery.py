"""Pictures of what a model makes of a list of prompts.

    python -m experiments.studies.gallery --model=DIR --prompts=FILE --out=DIR

FILE is a text with a prompt a line, or JSON (lists of texts, or of objects with a "prompt"). OUT receives a picture a
prompt and gallery.md, which names for every picture what the prompt asks for and what each scene shows, read by rule,
and sums up at its head how much of what was asked for is there. With --pick 8 scenes are chosen and tidied as
by ``scjax generate``; by default they are as sampled.
"""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
import warnings
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import jax
from tqdm import tqdm

import scjax
from experiments.studies.arguments import parser_of
from scjax.generate.best_of import prompt_warnings
from scjax.language.facts import extract_facts
from scjax.language.prompt_parser import check, parse_prompt
from scjax.nn.startup import start_jax
from scjax.viz.grid import grid


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of("gallery", __doc__)
    add = parser.add_argument
    add("--model", help="model folder (default: the one that ships)")
    add("--prompts", required=True, type=Path, help="file of prompts")
    add("--out", required=True, type=Path, help="folder for pictures and gallery.md")
    add("--samples", type=int, default=3, help="scenes a prompt (default %(default)s)")
    add("--guidance", type=float, help="weight (default: the model's)")
    add("--steps", type=int, help="sampling steps (default: the sampler's own)")
    add("--seed", type=int, default=0)
    add(
        "--pick",
        type=int,
        default=1,
        metavar="K",
        help="candidates a scene, of which the best is tidied and kept; 1: as sampled (default %(default)s)",
    )
    add("--numbers-only", action="store_true", help="name prompts by number, for texts that are not ours to repeat")
    args = parser.parse_args(arguments)
    try:
        make(args)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.gallery: {error}")


def make(args: argparse.Namespace) -> None:
    """The whole gallery, prompt by prompt."""
    prompts = read_prompts(args.prompts)
    model = scjax.load(args.model)
    args.out.mkdir(parents=True, exist_ok=True)
    lines: list[str] = []
    totals: dict[str, list[bool]] = defaultdict(list)
    for number, prompt in enumerate(tqdm(prompts, "prompts", disable=None), 1):
        condition = scjax.Condition(prompt=prompt)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            scenes = scjax.sample(
                jax.random.fold_in(jax.random.key(args.seed), number),
                [condition],
                model=model,
                num_scenes=args.samples,
                num_steps=args.steps,
                guidance=args.guidance,
                best_of=args.pick,
                repair=args.pick > 1,
            )
        name = f"prompt-{number:02d}.png"
        grid(scenes, columns=args.samples, path=args.out / name, dpi=60)
        lines += [f"## {number}" if args.numbers_only else f"## {number}. {textwrap.shorten(prompt, 300)}", ""]
        lines += [f"![{number}]({name})", ""]
        asked = parse_prompt(prompt)
        for scene in scenes:
            facts = extract_facts(scene)
            checked = check(asked, facts)
            for what, good in checked.items():
                totals[what].append(good)
            said = ", ".join(f"{what} {'yes' if good else 'NO'}" for what, good in checked.items())
            traffic = facts.traffic
            lines.append(
                f"- {facts.layout}; {traffic.vehicles} vehicles, {traffic.pedestrians} pedestrians, "
                f"{traffic.cyclists} cyclists; light {facts.signals or 'not told'}; events "
                f"{', '.join(facts.events) or 'none'} ({said or 'nothing to check'})"
            )
        doubtful = [f"warning: {one}" for one in (*(one.message for one in told), *prompt_warnings(condition))]
        if args.numbers_only and doubtful:
            doubtful = ["warned about, in words that quote it"]
        lines += [*(f"- {one}" for one in doubtful), ""]
    how = "as sampled" if args.pick == 1 else f"each the best of {args.pick}, tidied"
    kept = ", ".join(f"{what} {sum(good)} of {len(good)}" for what, good in sorted(totals.items()))
    made = f"{args.samples} scenes a prompt, {how}, seed {args.seed}, by `python -m experiments.studies.gallery`."
    head = ["# Gallery", "", made, "", f"What prompts ask for and scenes show, by rule: {kept or 'nothing'}.", ""]
    (args.out / "gallery.md").write_text("\n".join(head + lines))
    print(args.out / "gallery.md")


def read_prompts(path: Path) -> list[str]:
    """Prompts of a file.

    Raises:
      ValueError: naming the file, if it holds none.
    """
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == ".json" else text.splitlines()
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: neither lines of text nor JSON ({error})") from error
    if isinstance(content, dict):
        content = [item for value in content.values() for item in (value if isinstance(value, list) else [value])]
    found = [text.strip() for text in map(_text, content) if text.strip()]
    if not found:
        raise ValueError(f"{path}: holds no prompts: write one a line")
    return found


def _text(item: object) -> str:
    """A text, the "prompt" of an object, or its "condition" if its "type" is "text" (as on the paper's page)."""
    if not isinstance(item, dict):
        return str(item)
    return item.get("prompt", "") or (item.get("condition", "") if item.get("type") == "text" else "")


if __name__ == "__main__":
    start_jax()
    main()
