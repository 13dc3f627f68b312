"""Makes pages of docs/results again: runs the commands at the head of each page.

    python -m experiments.reproduce rollouts gallery
    python -m experiments.reproduce --show world

Commands run in the order of the page, each only if those before it succeed. What they read (../shared, records under
runs/) must be there; the pages say how it is made. The commands write the page or print its numbers.
"""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

RESULTS = Path(__file__).parents[1] / "docs" / "results"
_COMMAND = re.compile(r"(?:python|scjax|bash|nice) ")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.reproduce",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    names = sorted(path.stem for path in RESULTS.glob("*.md") if head_commands(path.read_text(encoding="utf-8")))
    parser.add_argument("pages", nargs="+", metavar="PAGE", choices=names, help=f"of {', '.join(names)}")
    parser.add_argument("--show", action="store_true", help="only print the commands")
    args = parser.parse_args(arguments)
    for page in args.pages:
        for command in head_commands((RESULTS / f"{page}.md").read_text(encoding="utf-8")):
            print(command, flush=True)
            if not args.show:
                run(command)


def commands(text: str) -> list[str]:
    """The commands of this repository that a page names, in blocks or within a line, in order."""
    parts = re.findall(r"^```(\w*)\n(.*?)^```$|((?:^    .*\n)+)|`([^`]+)`", text, re.MULTILINE | re.DOTALL)
    blocks = [
        block + indented + " ".join(span.split())
        for language, block, indented, span in parts
        if language in ("", "bash")
    ]
    lines = [" ".join(line.split()) for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    return [line for line in lines if _COMMAND.match(line)]


def head_commands(text: str) -> list[str]:
    """The commands above the first table and below the title: those that make the page."""
    head = re.split(r"^(?:## |\|)", text, maxsplit=1, flags=re.MULTILINE)[0]
    return [command for command in commands(head) if "--" in command or not command.startswith("scjax ")]


def run(command: str) -> None:
    """Runs a command with this Python; stops with its exit status if it fails."""
    words = shlex.split(command)
    words[:1] = {"python": [sys.executable], "scjax": [sys.executable, "-m", "scjax"]}.get(words[0], words[:1])
    status = subprocess.run(words, check=False).returncode
    if status:
        sys.exit(status)


if __name__ == "__main__":
    main()
