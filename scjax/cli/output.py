"""Files that the commands write, named by prompt, seed and number; and the time that a command took."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import time
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from scjax.scene import Scene

_MAX_SLUG = 48  # characters


def _write_picture(scene: Scene, path: Path) -> None:
    from matplotlib.figure import Figure

    from scjax.viz.bev import plot_scene
    from scjax.viz.grid import save_figure

    figure = plot_scene(scene).figure
    assert isinstance(figure, Figure)  # a picture of its own, no part of another
    save_figure(figure, path)


def _write_json(scene: Scene, path: Path) -> None:
    from scjax.scene import io

    io.save_json(scene, path)


def _write_npz(scene: Scene, path: Path) -> None:
    from scjax.scene import io

    io.save_npz(scene, path)


WRITERS: dict[str, Callable[[Scene, Path], object]] = {
    "png": _write_picture,
    "svg": _write_picture,
    "json": _write_json,
    "npz": _write_npz,
}
"""File ending -> function that writes a scene. A new format is one more line."""

FORMATS = tuple(WRITERS)


def writable_folder(path: str | Path) -> Path:
    """The folder, created if it is missing.

    Raises:
      ValueError: it cannot be created or written to. Commands check this before they compute anything.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".scjax-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ValueError(
            f"{folder} cannot be written to ({error.strerror}): choose another folder with --out"
        ) from error
    return folder


def slug(text: str) -> str:
    """A short file name for a text in any language; texts that differ have names that differ.

    A name that does not tell the whole text ends in six digits of its hash.
    """
    plain = re.sub(r"[\W_]+", "-", unicodedata.normalize("NFC", text).lower()).strip("-")
    name = plain[:_MAX_SLUG].rstrip("-") or "scene"
    if text in (name, name.replace("-", " ")):
        return name
    return f"{name}-{hashlib.sha256(text.encode('utf-8', 'replace')).hexdigest()[:6]}"


def write_scene(scene: Scene, folder: Path, name: str, formats: Sequence[str]) -> list[Path]:
    """Writes one scene in every format; returns the files. Each appears whole or not at all."""
    paths = [folder / f"{name}.{ending}" for ending in formats]
    for ending, path in zip(formats, paths, strict=True):
        WRITERS[ending](scene, path)
    return paths


class Clock:
    """Times the parts of a command: ``with clock.part("sampling"): ...``"""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self._calls: dict[str, int] = {}

    @contextlib.contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Adds the time of its block to the part ``name`` [s]."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - start)

    def add(self, name: str, seconds: float) -> None:
        """Adds a time to the part ``name``."""
        self.parts[name] = self.parts.get(name, 0.0) + seconds
        self._calls[name] = self._calls.get(name, 0) + 1

    def summary(self) -> str:
        """All parts in one line; the mean of those that ran several times."""
        parts = ((name, seconds, self._calls[name]) for name, seconds in self.parts.items())
        return ", ".join(
            f"{name} {seconds:.1f} s" if calls == 1 else f"{calls} {name} {seconds / calls:.1f} s each"
            for name, seconds, calls in parts
        )


@contextlib.contextmanager
def progress_bar(text: str, unit: str = "part", *, delay: float = 0.0) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr if that is a terminal. The function that it gives is called with the parts so far and of all.

    Args:
      delay: seconds before the bar appears.
    """
    from tqdm import tqdm

    with tqdm(desc=text, unit=unit, delay=delay, leave=False, disable=None) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield progress


def say(text: str, quiet: bool = False) -> None:
    """A line for people: on stderr, so that stdout holds results alone."""
    if not quiet:
        click.echo(text, err=True)
