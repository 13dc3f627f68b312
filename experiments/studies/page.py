"""What all studies share: a parser whose help is the docstring, and a page of markdown, JSON and a picture."""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scjax.scene.files import write_text
from scjax.viz.grid import save_figure


def script_parser(module: str, doc: str | None) -> argparse.ArgumentParser:
    """A parser for ``python -m MODULE``; the first line of the docstring stands above the options."""
    summary, _, details = (doc or "").partition("\n")
    return argparse.ArgumentParser(
        prog=f"python -m {module}",
        description=summary,
        epilog=details,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_sampling_options(parser: argparse.ArgumentParser, runs: str, seed: str) -> None:
    """--model, --runs, --seed and --out of a study that keeps what it samples.

    Args:
      runs: default folder.
      seed: what the seed is of.
    """
    parser.add_argument("--model", help="model folder (default: the one that ships)")
    parser.add_argument("--runs", type=Path, default=Path(runs), help="(default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help=f"{seed} (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")


def command_line(name: str, arguments: Sequence[str] | None) -> str:
    """The command that makes a page, for its head."""
    given = sys.argv[1:] if arguments is None else arguments
    return f"python -m experiments.studies.{name} {shlex.join(given)}"


def write_page(out: Path, text: str, content: Any, figure: Figure | None = None) -> None:
    """Writes OUT.md, OUT.json and, with a figure, OUT.png; the page ends with ``made_at`` and the picture."""
    text = f"{text.rstrip()}\n\n{made_at()}\n"
    out.parent.mkdir(parents=True, exist_ok=True)
    if figure is not None:
        save_figure(figure, out.with_name(f"{out.name}.png"), dpi=100)
        text = f"{text.rstrip()}\n\n![{out.name}]({out.name}.png)\n"
    write_text(out.with_name(f"{out.name}.json"), json.dumps(content, separators=(",", ":")))
    write_text(out.with_name(f"{out.name}.md"), text)


def made_at() -> str:
    """A sentence that says at which commit of the code, and on what machine, a page is made."""

    def git(*words: str) -> str:
        root = Path(__file__).parents[2]
        return subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=False).stdout.strip()

    commit = git("rev-parse", "--short=7", "HEAD") or "unknown"
    if git("status", "--porcelain", "--untracked-files=no"):
        commit += ", with changes,"
    cpus = Path("/proc/cpuinfo")
    found = re.search(r"^model name\s*: (.*)$", cpus.read_text(), re.MULTILINE) if cpus.is_file() else None
    return f"Made at commit {commit} on {os.cpu_count()} cores of {found[1] if found else 'an unknown processor'}."


def rounded(content: Any, digits: int = 4) -> Any:
    """Content of a page whose numbers have as many significant digits as anybody reads: files stay small."""
    if isinstance(content, dict):
        return {name: rounded(value, digits) for name, value in content.items()}
    if isinstance(content, list | tuple):
        return [rounded(value, digits) for value in content]
    return float(f"{content:.{digits}g}") if isinstance(content, float) else content


def new_figure(width: float, height: float) -> Figure:
    """A figure [inches] that needs no display."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows)]
