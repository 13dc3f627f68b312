"""Readers of recorded data sets, one format per file; each turns a folder into logs (``scjax.scene.Log``)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from scjax.data.readers.base import LogInfo, LogReader
from scjax.data.readers.scene_json import PATTERN, SceneJsonReader

READERS: dict[str, Callable[[str], LogReader]] = {  # file pattern -> reader of a folder of such files
    PATTERN: SceneJsonReader,
}


def open_folder(folder: str | Path) -> LogReader:
    """The reader whose files lie below ``folder``; of several the first in ``READERS``.

    Raises:
      ValueError: if the folder does not exist or holds files of no known format.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder: give the folder that holds the recorded scenes")
    for pattern, reader in READERS.items():
        if next(folder.rglob(pattern), None) is not None:
            return reader(str(folder))
    raise ValueError(f"{folder}: no {' or '.join(READERS)} scenes there: give the folder that holds them")


__all__ = ["READERS", "LogInfo", "LogReader", "open_folder"]
