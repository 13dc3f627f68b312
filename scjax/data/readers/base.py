"""The protocol of readers: a folder of some data set's format -> logs."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Protocol, runtime_checkable

from scjax.scene import Log


@dataclasses.dataclass(frozen=True)
class LogInfo:
    """What a reader knows of a log at little cost.

    Attributes:
      file: name of the log in its source.
      sha256: hash of its content.
      domain, cluster: data set and location, as in ``LogMetadata``.
      reason: why the log cannot be used; empty if it can.
      split: "train" or "val" where the source holds locations back itself; empty if their names decide.
    """

    file: str
    sha256: str = ""
    domain: str = ""
    cluster: str = ""
    reason: str = ""
    split: str = ""


@runtime_checkable
class LogReader(Protocol):
    """The logs of one source by name. Implementations are small, and can be sent to worker processes.

    A new format is one file with a class of these methods, and one line in ``scjax.data.readers.READERS``.
    """

    def names(self) -> list[str]:
        """Names of all logs, in order; ValueError if there are none."""
        ...

    def scan(self, name: str) -> LogInfo:
        """Content hash and location of a log, or why it cannot be used; does not raise."""
        ...

    def read(self, name: str) -> Log:
        """The log; ValueError naming the file if it cannot be used."""
        ...


@dataclasses.dataclass(frozen=True)
class OneLog:
    """A single log of a reader."""

    reader: LogReader
    name: str

    def __str__(self) -> str:
        return str(Path(str(self.reader), self.name))

    def names(self) -> list[str]:
        """Its name."""
        return [self.name]

    def scan(self, name: str) -> LogInfo:
        """As the reader's."""
        return self.reader.scan(name)

    def read(self, name: str) -> Log:
        """As the reader's."""
        return self.reader.read(name)


def files_below(folder: str | Path, pattern: str, skipped: tuple[str, ...] = ()) -> list[str]:
    """Files of a pattern relative to a folder, sorted.

    Args:
      skipped: beginnings of the names of folders that are left out.

    Raises:
      ValueError: if the folder does not exist or holds none.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder: give the folder that holds the {pattern} files")
    paths = (path.relative_to(folder) for path in folder.rglob(pattern))
    files = sorted(path.as_posix() for path in paths if not any(part.startswith(skipped) for part in path.parts[:-1]))
    if not files:
        raise ValueError(f"{folder}: no {pattern} files there: give the folder that holds them")
    return files
