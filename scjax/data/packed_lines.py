"""Lines of text packed by gzip, one for each record: read with a limit on their length, whatever the file holds."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from pathlib import Path

from scjax.scene.files import MEGABYTE

_MAX_LINE = MEGABYTE  # bytes


def read_lines(path: Path, remedy: str) -> Iterator[bytes]:
    """The lines of a packed file of text; at least one, if it is empty an empty one.

    Args:
      remedy: command that writes the file, for the end of a message.

    Raises:
      ValueError: the file is damaged, or a line is cut short or too long; names file and line.
    """
    number = 1
    with path.open("rb") as packed, gzip.GzipFile(fileobj=packed) as file:
        while True:
            try:
                line = file.readline(_MAX_LINE)
            except (OSError, EOFError, zlib.error) as error:
                raise ValueError(f"{path}, line {number}: the file is damaged ({error}): {remedy} again") from error
            if line and not line.endswith(b"\n"):
                raise ValueError(f"{path}, line {number}: it is cut short, or longer than any line: {remedy} again")
            if not line and number > 1:
                return
            yield line
            number += 1
