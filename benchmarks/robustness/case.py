"""One damaged input, and how it ended."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

OUTCOMES = ("ok", "clean", "unnamed", "traceback", "hang", "memory", "wrong")
FAULTS = OUTCOMES[2:]
SOUND = "undamaged"
"""Text of an input that must be accepted: it shows that an area reads what it means to, and that its check passes."""


class Unavailable(Exception):
    """The code under test lacks what an area needs; the text says what."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A damaged input.

    Attributes:
      text: what is damaged, and how.
      run: reads the input; gets the folder that ``write`` filled.
      check: what is wrong with an accepted result, None if nothing is.
      names: a refusal must name one of these (file, field, argument).
      write: writes the input's files into a folder.
    """

    text: str
    run: Callable[[Path], Any]
    check: Callable[[Any], str | None]
    names: tuple[str, ...]
    write: Callable[[Path], None] = lambda folder: None


@dataclasses.dataclass(frozen=True)
class Refused:
    """How a process or a function refused an input without an exception in this process.

    Attributes:
      text: what the user reads.
      code: exit status; below 0: a signal.
    """

    text: str
    code: int


@dataclasses.dataclass(frozen=True)
class Result:
    """How one input ended; ``error`` and ``place`` are of the exception."""

    outcome: str
    text: str
    error: str = ""
    place: str = ""
    message: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0
