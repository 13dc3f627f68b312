"""Files that appear whole or not at all, bounded reading, and locks on folders."""

from __future__ import annotations

import contextlib
import gzip
import os
import platform
import re
import shutil
import uuid
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

MEGABYTE = 1_000_000
MAX_EXPANSION = 16
"""Bytes that a compressed file may expand to, for each of its own; small files may have ``MIN_LIMIT`` in any case."""

MIN_LIMIT = 64 * MEGABYTE
_NODE = re.sub(r"\W", "", platform.node())[:16] or "host"
_PART = re.compile(rf"\..+\.{_NODE}-(\d+)-[0-9a-f]+\.part")
LOCK_FILE = ".scjax.lock"


@contextlib.contextmanager
def whole_file(path: str | Path, *, clean: bool = True) -> Iterator[IO[bytes]]:
    """A file to write, which gets its name ``path`` at the end of the block: readers never see half a file.

    Missing folders are created. The temporary file is removed if the block fails; what killed processes left of the
    same file is removed first.

    Args:
      clean: whether it is; that reads the whole folder, so writers of many files do it once.

    Raises:
      OSError: as usual, but always with the name of the file.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if clean:
            remove_stale_parts(path.parent, path.name)
        temporary = part_path(path)
        try:
            with temporary.open("wb") as file:
                yield file
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        if error.filename is None or _PART.fullmatch(Path(str(error.filename)).name):
            raise type(error)(error.errno, error.strerror or str(error), str(path)) from error
        raise


def write_file(path: Path, write: Callable[[IO[bytes]], Any], *, clean: bool = True) -> None:
    """Calls ``write`` with the file of ``whole_file(path, clean=clean)``."""
    with whole_file(path, clean=clean) as file:
        write(file)


def write_text(path: Path, text: str) -> None:
    """``write_file`` of a text in UTF-8."""
    write_file(path, lambda file: file.write(text.encode()))


def part_path(path: Path) -> Path:
    """A temporary name beside ``path``, which says what process of what machine writes it."""
    return path.with_name(f".{path.name[:100]}.{_NODE}-{os.getpid()}-{uuid.uuid4().hex[:8]}.part")


def remove_stale_parts(folder: Path, name: str = "") -> None:
    """Removes temporary files and folders of processes of this machine that have ended.

    Args:
      name: only those of this file; by default all in the folder.
    """
    for part in folder.glob(f".{_escaped(name[:100])}.{_NODE}-*.part" if name else ".*.part"):
        match = _PART.fullmatch(part.name)
        if match is None or _is_running(int(match[1])):
            continue
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink(missing_ok=True)


def _escaped(name: str) -> str:
    return re.sub(r"([*?\[])", r"[\1]", name)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is another user's
        return True
    with contextlib.suppress(OSError):  # Linux: a process that has ended, but that nobody waited for
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    return True


def read_limited(path: str | Path) -> bytes:
    """The content of a file, decompressed if its name ends in .gz.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: naming the file: it cannot be read, its gzip is damaged, or it expands to more than ``size_limit``.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
        if path.suffix != ".gz":
            return data
        if not data:
            raise EOFError("it is empty")  # an empty string decompresses to nothing without complaint
        limit = size_limit(len(data))
        with gzip.open(path, "rb") as file:
            content = file.read(limit + 1)
    except FileNotFoundError:
        raise
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: not a complete file ({_reason(error)}): copy or download it again") from error
    if len(content) > limit:
        raise ValueError(f"{path}: expands to more than {limit // MEGABYTE} MB: this is no file of its format")
    return content


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def size_limit(stored: int) -> int:
    """Bytes that ``stored`` compressed bytes may expand to."""
    return max(MIN_LIMIT, MAX_EXPANSION * stored if stored > 10 * MEGABYTE else 0)


@contextlib.contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Holds the folder, made if it is missing, for this process alone.

    Raises:
      ValueError: another process holds it.
    """
    from filelock import FileLock, Timeout

    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / LOCK_FILE, timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise ValueError(
            f"{folder} is in use by another process, whose files would mix with these: wait for its end, or choose "
            "another folder"
        ) from error
    except OSError as error:
        raise OSError(error.errno, f"the folder cannot be locked: {error.strerror}", str(folder / LOCK_FILE)) from error
    try:
        yield
    finally:
        lock.release()


@contextlib.contextmanager
def whole_folder(folder: Path, what: str) -> Iterator[Path]:
    """An empty folder to write to, which takes the place of ``folder`` at the end, as a whole, or not at all.

    Args:
      what: is written, for messages.

    Raises:
      OSError: it cannot be written; names ``folder``.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_stale_parts(folder.parent, folder.name)
    temporary = part_path(folder)
    temporary.mkdir()
    try:
        yield temporary
        replace_folder(temporary, folder)
    except OSError as error:
        raise OSError(error.errno, f"{what} cannot be written: {error.strerror}", str(folder)) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def replace_folder(new: Path, folder: Path) -> None:
    """Puts the folder ``new`` in place of ``folder``, which exists at every moment if it did before.

    Where the system can exchange two names (Linux), it does; elsewhere there is a moment without the folder.
    """
    if not folder.exists():
        new.rename(folder)
        return
    retired = new  # after an exchange it holds the old content
    if not _exchange(new, folder):
        retired = part_path(folder)
        folder.rename(retired)
        new.rename(folder)
    shutil.rmtree(retired, ignore_errors=True)


def _exchange(one: Path, other: Path) -> bool:
    """Exchanges two names at once; False where the system or the file system cannot."""
    import ctypes

    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    at_cwd, exchange = -100, 2
    return rename(at_cwd, os.fsencode(one), at_cwd, os.fsencode(other), exchange) == 0
