"""The parser of a script whose docstring is its help: the first line above the options, the rest below them."""

from __future__ import annotations

import argparse


def parser_of(name: str, doc: str | None) -> argparse.ArgumentParser:
    """For ``python -m experiments.<name>``."""
    summary, _, more = (doc or "").partition("\n")
    return argparse.ArgumentParser(
        prog=f"python -m experiments.{name}",
        description=summary,
        epilog=more,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
