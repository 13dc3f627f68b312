"""Readers of recorded data sets and maps, one format per file; each turns a folder into logs (``scjax.scene.Log``)."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

from scjax.data.readers.av2_map import AV2_MAP
from scjax.data.readers.base import FileFormat, FormatReader, LogInfo, LogReader, OneLog
from scjax.data.readers.commonroad import COMMONROAD
from scjax.data.readers.lanelet2 import LANELET2
from scjax.data.readers.opendrive import OPENDRIVE
from scjax.data.readers.scenarionet import SCENARIONET
from scjax.data.readers.scene_json import PATTERN, SceneJsonReader

FORMATS: tuple[FileFormat, ...] = (OPENDRIVE, COMMONROAD, LANELET2, SCENARIONET, AV2_MAP)
"""Formats of which every file is one log; a new one is one more name."""

READERS: dict[str, Callable[[str], LogReader]] = {  # file pattern -> reader of a folder of such files
    PATTERN: SceneJsonReader,
    **{entry.pattern: functools.partial(FormatReader, entry) for entry in FORMATS},
}


def open_folder(folder: str | Path) -> LogReader:
    """The reader whose files lie below ``folder``, of several the first in ``READERS``; or that of a single file.

    Raises:
      ValueError: if the folder does not exist or holds files of no known format, or a file is of none.
    """
    folder = Path(folder)
    if folder.is_file():
        for pattern, reader in READERS.items():
            if folder.match(pattern):
                return OneLog(reader(str(folder.parent)), folder.name)
        raise ValueError(f"{folder}: neither {' nor '.join(READERS)}: give such a file, or the folder that holds them")
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder: give the folder that holds the recorded scenes")
    for pattern, reader in READERS.items():
        if next(folder.rglob(pattern), None) is not None:
            return reader(str(folder))
    raise ValueError(f"{folder}: no {' or '.join(READERS)} scenes there: give the folder that holds them")


__all__ = ["FORMATS", "READERS", "FileFormat", "FormatReader", "LogInfo", "LogReader", "open_folder"]
