"""The protocol of readers: a folder of some data set's format -> logs; and the reader of formats of one log a file."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol, runtime_checkable

from scjax.scene import Log
from scjax.scene.files import MEGABYTE, read_limited

MAX_FILE_BYTES = 500 * MEGABYTE


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

    A new format is one file with a ``FileFormat``, or a class of these methods, and one line in
    ``scjax.data.readers.FORMATS`` or ``READERS``.
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


@dataclasses.dataclass(frozen=True)
class FileFormat:
    """A format of which every file is one log.

    Attributes:
      name: of the format, for people.
      pattern: of the names of files, for folders.
      domain: ``LogMetadata.domain``; empty if a file says it.
      matches: whether the content of a file, of which it gets the first bytes, is of this format.
      read: path and location -> log. An empty location is that of the file.
      names_location: whether the file itself says where it is; otherwise its path does.
    """

    name: str
    pattern: str
    domain: str
    matches: Callable[[bytes], bool]
    read: Callable[[Path, str], Log]
    names_location: bool = False


@dataclasses.dataclass(frozen=True)
class FormatReader:
    """Every file of a format below a folder. Names and locations are the paths in the folder."""

    format: FileFormat
    folder: str

    def __str__(self) -> str:
        return self.folder

    def names(self) -> list[str]:
        """Files relative to the folder, sorted.

        Raises:
          ValueError: if the folder does not exist or holds none.
        """
        return files_below(self.folder, self.format.pattern)

    def scan(self, name: str) -> LogInfo:
        """Hash and location of a file, or the reason why it cannot be read."""
        try:
            if self.format.names_location:
                metadata = self.read(name).metadata
                return LogInfo(name, metadata.source_sha256, metadata.domain, metadata.location_cluster)
            data = read_file_bytes(Path(self.folder, name))
        except ValueError as error:
            return LogInfo(name, reason=str(error))
        return LogInfo(name, hashlib.sha256(data).hexdigest(), self.format.domain, self._location(name))

    def read(self, name: str) -> Log:
        """The log in a file of the folder.

        Raises:
          ValueError: naming the file, if it cannot be used.
        """
        return self.format.read(Path(self.folder, name), "" if self.format.names_location else self._location(name))

    def _location(self, name: str) -> str:
        return name.removesuffix(Path(name).suffix)


def read_file_bytes(path: str | Path) -> bytes:
    """The content of a file, decompressed if its name ends in .gz.

    Raises:
      ValueError: naming the file: there is none, it cannot be read, or it has more than ``MAX_FILE_BYTES``.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise ValueError(
                f"{path}: it has {size // MEGABYTE} MB, more than {MAX_FILE_BYTES // MEGABYTE}: split the map"
            )
        return read_limited(path)
    except FileNotFoundError as error:
        raise ValueError(f"{path}: No such file: give the file of a map or recording") from error


@contextlib.contextmanager
def naming_file(path: str | Path) -> Iterator[None]:
    """Within it, errors name the file."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


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
