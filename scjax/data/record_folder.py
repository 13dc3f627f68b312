"""The folder of records, captions and features, for one writing process at a time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from scjax.scene.files import locked_folder


@contextlib.contextmanager
def locked_records(folder: Path) -> Iterator[None]:
    """Holds the folder for this process alone, and removes the temporary files that killed processes left there.

    Nobody else writes there meanwhile, so files of every name and process are removed, also those of earlier versions.

    Raises:
      ValueError: another process holds it.
    """
    with locked_folder(folder):
        for part in (*folder.glob(".*.part"), *folder.glob("progress/.*.part")):
            if part.is_file():
                part.unlink(missing_ok=True)
        yield
