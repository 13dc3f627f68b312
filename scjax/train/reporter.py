"""Reports of a training: metrics.jsonl always, TensorBoard where it is installed, a progress bar on a terminal."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from tqdm import tqdm

from scjax.scene.files import write_file
from scjax.train.tensorboard import TensorBoardWriter


class Reporter:
    """Writes scalars and pictures of one run into its folder; a context manager.

    Args:
      folder: of the run; made if it is missing.
      first_step: step that the run continues after; what was reported of later ones is removed, since they come again.
      last_step: end of the progress bar.
      tensorboard: whether to write TensorBoard files as well.
      quiet: write no files and show nothing, as processes other than the first do.
    """

    def __init__(self, folder: Path, *, first_step: int, last_step: int, tensorboard: bool, quiet: bool = False):
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._quiet = folder, quiet
        self._lines: TextIO | None = None if quiet else _opened(folder / "metrics.jsonl", first_step)
        has_board = tensorboard and not quiet
        self._board = TensorBoardWriter(folder / "tensorboard", first_step) if has_board else None
        self._is_terminal = sys.stderr.isatty()
        self._bar = tqdm(initial=first_step, total=last_step, unit="step", disable=quiet or not self._is_terminal)

    def __enter__(self) -> Reporter:
        return self

    def __exit__(self, *exception) -> None:
        self._bar.close()
        if self._lines is not None:
            self._lines.close()
        if self._board is not None:
            self._board.close()

    def advance(self) -> None:
        """Counts one training step."""
        self._bar.update()

    def scalars(self, step: int, values: dict[str, Any], *, scope: str = "train") -> None:
        """Writes one line of metrics.jsonl, TensorBoard scalars and the bar's text."""
        if self._lines is None:
            return
        numbers = {name: float(np.asarray(value)) for name, value in values.items()}
        now = time.time()
        self._lines.write(json.dumps({"step": step, "scope": scope, "time": now, **numbers}) + "\n")
        self._lines.flush()
        if self._board is not None:
            self._board.scalars(step, now, {f"{scope}/{name}": value for name, value in numbers.items()})
        text = " ".join(f"{name}={value:.4g}" for name, value in numbers.items())
        self._bar.set_postfix_str(text[:120], refresh=False)
        if not self._is_terminal:
            print(f"{scope} step {step}: {text}", flush=True)

    def picture_path(self, step: int, name: str) -> Path:
        """The file for a picture of this step."""
        folder = self._folder / "pictures"
        folder.mkdir(exist_ok=True)
        return folder / f"{name}_{step:07d}.png"


def _opened(path: Path, last_step: int) -> TextIO:
    """The file, open for appending, without lines of later steps and without lines that a kill left incomplete."""
    if path.exists():
        lines = path.read_bytes().splitlines(keepends=True)
        kept = [line for line in lines if _is_until(line, last_step)]
        if len(kept) < len(lines):
            write_file(path, lambda file: file.writelines(kept))
    return path.open("a", encoding="utf-8")


def _is_until(line: bytes, last_step: int) -> bool:
    try:
        content = json.loads(line)
        return line.endswith(b"\n") and int(content["step"]) <= last_step
    except (ValueError, TypeError, KeyError, RecursionError):
        return False
