"""Folders of weights that ship with the package: replaced as a whole, but for their card."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

_CARD = "README.md"


def replace_packaged(folder: Path, save: Callable[[Path], object]) -> None:
    """Calls ``save(folder)``, which replaces the folder, puts its card back, and prints the sizes of all files."""
    card = (folder / _CARD).read_text() if (folder / _CARD).is_file() else None
    save(folder)
    if card is not None:
        (folder / _CARD).write_text(card)
    for path in sorted(folder.iterdir()):
        print(f"{path.stat().st_size / 1e6:6.2f} MB  {path.name}")
