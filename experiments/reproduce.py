"""Makes the pages of docs/results again: python -m experiments.reproduce sampling_steps gallery ...

Every page has one entry in ``PAGES``: the studies that measure, and the records that they need. Records are made once
per folder of --runs. Without page names all pages are made, in about half an hour on two CPU cores.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

RECORDS = {
    "records": (
        "scjax.data synthetic {folder} --worlds 2000",
        "scjax.data attributes {folder}",
    ),
    "pictures": ("scjax.data dashcam {runs}/records {folder}",),
}
"""Synthetic worlds that no training of the shipped model saw, and their pictures: folder of --runs -> commands."""


@dataclasses.dataclass(frozen=True)
class Page:
    """One page of docs/results, ``OUT.md`` beside ``OUT.json`` and ``OUT.png``.

    Attributes:
      commands: modules and arguments, in order; {runs} and {out} are folders.
      records: names in ``RECORDS`` that the commands read.
    """

    commands: tuple[str, ...]
    records: tuple[str, ...] = ()


PAGES = {
    "sampling_steps": Page(
        (
            "experiments.studies.samplers --model scjax/pretrained --records {runs}/records --samples 96"
            " --samplers ddpm --num-steps 10 16 25 50 100 --repeats 1"
            " --workdir {runs}/sampling_steps --out {out}/sampling_steps",
        ),
        ("records",),
    ),
    "image_control": Page(
        (
            "experiments.studies.image_control --records {runs}/records --pictures {runs}/pictures"
            " --out {out}/image_control",
        ),
        ("records", "pictures"),
    ),
    "gallery": Page(
        ("experiments.studies.gallery --prompts experiments/prompts/free_form.txt --samples 3 --out {out}/gallery",)
    ),
}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.reproduce",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("pages", nargs="*", metavar="PAGE", help=f"of {', '.join(PAGES)} (default: all)")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for records (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("docs/results"), help="folder (default: %(default)s)")
    args = parser.parse_args(arguments)
    unknown = sorted(set(args.pages) - set(PAGES))
    if unknown:
        parser.error(f"no page {', '.join(unknown)}: choose from {', '.join(PAGES)}")
    for name in args.pages or PAGES:
        make_page(name, args.runs, args.out)


def make_page(name: str, runs: Path, out: Path) -> None:
    """Makes the records that are missing and runs the commands of a page."""
    page = PAGES[name]
    for records in page.records:
        make_records(records, runs)
    out.mkdir(parents=True, exist_ok=True)
    for command in page.commands:
        run(command.format(runs=runs, out=out))


def make_records(name: str, runs: Path) -> None:
    """The records of ``RECORDS[name]`` in ``runs/name``; nothing is done if they are complete."""
    folder = runs / name
    done = folder / "reproduce.json"
    commands = [command.format(folder=folder, runs=runs) for command in RECORDS[name]]
    if done.is_file() and json.loads(done.read_text(encoding="utf-8")) == commands:
        return
    for command in commands:
        run(command)
    done.write_text(json.dumps(commands), encoding="utf-8")


def run(command: str) -> None:
    """Runs a module of this Python; stops with its exit status if it fails."""
    print(f"python -m {command}", file=sys.stderr, flush=True)
    status = subprocess.run([sys.executable, "-m", *shlex.split(command)], check=False).returncode
    if status:
        sys.exit(status)


if __name__ == "__main__":
    main()
