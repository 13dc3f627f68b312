"""What the commands write: scenes in several formats, named by prompt, seed and number; and the time it took."""

from __future__ import annotations

import contextlib
import os
import re
import time
import unicodedata
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import click
from matplotlib.figure import Figure

from scjax.scene import Scene

Format = Literal["png", "svg", "json", "npz"]
FORMATS: tuple[Format, ...] = ("png", "svg", "json", "npz")
CANDIDATES = 8  # a scene by default
PICK_HELP = (
    "Candidates a scene: the one that shows most of the prompt, then the one with the fewest faults, is kept. They are "
    "made some at a time, and one without fault ends the search."
)
_LONGEST = 48  # characters of a file name's text


def writable_folder(path: str | Path) -> Path:
    """The folder, made if it is not there.

    Raises:
      ValueError: it cannot be made or written to; said before anything is computed.
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
    """A short file name for a text in any language."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    return re.sub(r"[^a-z0-9]+", "-", plain).strip("-")[:_LONGEST].rstrip("-") or "scene"


def write_scene(scene: Scene, folder: Path, name: str, formats: Sequence[Format], title: str | None) -> list[Path]:
    """Writes one scene in every format; returns the files. Each appears whole or not at all."""
    from scjax.scene import io as scene_io

    written = []
    for kind in formats:
        path = folder / f"{name}.{kind}"
        if kind == "npz":
            scene_io.save_npz(scene, path)
        elif kind == "json":
            scene_io.save_json(scene, path)
        else:
            from scjax.viz.bev import plot_scene
            from scjax.viz.grid import save_figure

            figure = plot_scene(scene, title=title).figure
            assert isinstance(figure, Figure)  # a picture of its own, no part of another
            save_figure(figure, path)
        written.append(path)
    return written


class Clock:
    """Times parts of a command: with clock.part("sampling"): ..."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self._times: dict[str, int] = {}

    @contextlib.contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Adds what runs within it to the part ``name`` [s]."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.parts[name] = self.parts.get(name, 0.0) + time.perf_counter() - start
            self._times[name] = self._times.get(name, 0) + 1

    def told(self) -> str:
        """All parts in one line; of those that ran several times the mean."""
        shares = ((name, seconds, self._times[name]) for name, seconds in self.parts.items())
        return ", ".join(
            f"{name} {seconds:.1f} s" if times == 1 else f"{times} {name} {seconds / times:.1f} s each"
            for name, seconds, times in shares
        )


def say(text: str, quiet: bool = False) -> None:
    """A line for people: on stderr, so that stdout holds results alone."""
    if not quiet:
        click.echo(text, err=True)
