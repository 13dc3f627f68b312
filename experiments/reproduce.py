"""Makes the pages of docs/results again: python -m experiments.reproduce prompt_adherence guidance ...

Every page has one entry in ``PAGES``: its title and question, the records that it needs, and the study that measures.
Records are made once per folder of --runs. Without page names all pages are made, in about an hour on two CPU cores.
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
        "scjax.data caption {folder}",
        "scjax.data embed {folder} --split val",
    ),
    "events": (
        "scjax.data synthetic {folder} --worlds 4000 --seed 11 --ordinary 0.05 --split-percent 90",
        "scjax.data caption {folder} --paraphrases 1",
        "scjax.data embed {folder} --split val",
    ),
}
"""Synthetic worlds that no training of the shipped model saw: folder of --runs -> commands."""


@dataclasses.dataclass(frozen=True)
class Page:
    """One page of docs/results.

    Attributes:
      title, question: its first lines.
      command: module and arguments of the study; {runs} and {out} are folders.
      records: names in ``RECORDS`` that the study reads.
      table: file that the study writes, with the page's tables; "" if it writes the page itself.
      picture: file that the study draws, if any.
    """

    title: str
    question: str
    command: str
    records: tuple[str, ...] = ()
    table: str = ""
    picture: str = ""


PAGES = {
    "prompt_adherence": Page(
        "Prompt adherence",
        "Do single samples show what ordinary prompts ask for? 500 captions of held-back synthetic scenes, read by rule.",
        "experiments.studies.prompt_adherence --records {runs}/records --samples 500 --out {out}/prompt_adherence",
        records=("records",),
        table="prompt_adherence.md",
    ),
    "rare_events": Page(
        "Rare events",
        "Do single samples show the rare event that a prompt names? 20 captions per event, read by rule.",
        "experiments.studies.prompt_adherence --records {runs}/events --each 20 --out {out}/rare_events",
        records=("events",),
        table="rare_events.md",
    ),
}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.reproduce", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
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
    """Makes the records that are missing, runs the study and writes the page ``out/NAME.md``."""
    page = PAGES[name]
    for records in page.records:
        make_records(records, runs)
    out.mkdir(parents=True, exist_ok=True)
    run(page.command.format(runs=runs, out=out))
    if page.table:
        table = out / page.table
        text = table.read_text(encoding="utf-8")
        (out / f"{name}.md").write_text(page_text(name, page, text), encoding="utf-8")


def page_text(name: str, page: Page, tables: str) -> str:
    """The whole page: title, question, command, picture, tables."""
    lines = [f"# {page.title}", "", page.question, "", f"    python -m experiments.reproduce {name}", ""]
    if page.picture:
        lines += [f"![{page.title}]({page.picture})", ""]
    return "\n".join(lines) + "\n" + tables.strip() + "\n"


def make_records(name: str, runs: Path) -> None:
    """The records of ``RECORDS[name]`` in ``runs/name``; nothing is done if they are complete."""
    folder = runs / name
    done = folder / "reproduce.json"
    commands = [command.format(folder=folder) for command in RECORDS[name]]
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
