"""What a run tells: metrics.jsonl always, TensorBoard where it is installed, a progress bar on a terminal."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from tqdm import tqdm


class Reporter:
    """Writes scalars and pictures of one run into its folder; a context manager."""

    def __init__(self, folder: Path, *, first_step: int, last_step: int, tensorboard: bool):
        folder.mkdir(parents=True, exist_ok=True)
        self._lines: TextIO = (folder / "metrics.jsonl").open("a")
        self._folder = folder
        self._board = _summary_writer(folder / "tensorboard") if tensorboard else None
        self._bar = tqdm(initial=first_step, total=last_step, unit="step", disable=not sys.stderr.isatty())
        self._quiet = not sys.stderr.isatty()

    def __enter__(self) -> Reporter:
        return self

    def __exit__(self, *exception) -> None:
        self._bar.close()
        self._lines.close()
        if self._board is not None:
            self._board.close()

    def advance(self) -> None:
        """One training step done."""
        self._bar.update()

    def scalars(self, step: int, values: dict[str, Any], *, scope: str = "train") -> None:
        """One line of metrics.jsonl, TensorBoard scalars and the bar's text."""
        plain = {name: float(np.asarray(value)) for name, value in values.items()}
        self._lines.write(json.dumps({"step": step, "scope": scope, "time": time.time(), **plain}) + "\n")
        self._lines.flush()
        if self._board is not None:
            for name, value in plain.items():
                self._board.add_scalar(f"{scope}/{name}", value, step)
        text = " ".join(f"{name}={value:.4g}" for name, value in plain.items())
        self._bar.set_postfix_str(text[:120], refresh=False)
        if self._quiet:
            print(f"{scope} step {step}: {text}", flush=True)

    def picture_path(self, step: int, name: str) -> Path:
        """Where a picture of this step belongs."""
        folder = self._folder / "pictures"
        folder.mkdir(exist_ok=True)
        return folder / f"{name}_{step:07d}.png"


def _summary_writer(folder: Path):
    from tensorboardX import SummaryWriter

    return SummaryWriter(str(folder))
