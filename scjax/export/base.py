"""The protocol of exports: a log -> files of some format, and what the format cannot say about it."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from scjax.scene import Log

Losses = Counter[str]
"""What a format cannot say about a log, in words -> how often."""


@dataclasses.dataclass(frozen=True)
class ExportReport:
    """What an export wrote.

    Attributes:
      paths: the files.
      losses: what of the log is not in them, or was filled in -> how often. Empty if the files say all.
    """

    paths: tuple[Path, ...]
    losses: dict[str, int]


@dataclasses.dataclass(frozen=True)
class Export:
    """A format that logs are written in.

    Attributes:
      title: name of the format, for people.
      suffix: of the file, as in ".xodr"; empty for a folder.
      consumers: programs that open the files.
      write: log, path, losses to add to -> the files. Raises ValueError if the log cannot be said in this format.
    """

    title: str
    suffix: str
    consumers: str
    write: Callable[[Log, Path, Losses], tuple[Path, ...]]
