"""Draws what trainings have reported: python -m experiments.plot_training runs/autoencoder runs/denoiser --out
curves.png

One panel for the training loss and one for every validation number, a line a run, over training steps.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scjax.viz.grid import save_figure

Series = dict[str, list[tuple[int, float]]]

_COLUMNS = 4


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.plot_training",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("runs", nargs="+", type=Path, help="WORKDIRs of trainings (or their metrics.jsonl)")
    parser.add_argument("--out", type=Path, default=Path("curves.png"), help="picture to write (default: curves.png)")
    args = parser.parse_args(arguments)
    try:
        draw({run.name if run.is_dir() else run.parent.name: read(run) for run in args.runs}, args.out)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.plot_training: {error}")
    print(args.out)


def read(run: Path) -> Series:
    """Loss of training and every validation number of a run; a step that was run again counts once, the last time.

    Raises:
      ValueError: if a line is not what training writes, or there is none.
    """
    path = run / "metrics.jsonl" if run.is_dir() else run
    series: dict[str, dict[int, float]] = defaultdict(dict)
    for number, text in enumerate(path.read_text().splitlines(), 1):
        try:
            line = json.loads(text)
            scope, step = line["scope"], int(line["step"])
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(f"{path}, line {number}: not a line that training writes ({error})") from None
        names = ["loss"] if scope == "train" else [name for name in line if name not in ("step", "scope", "time")]
        for name in names:
            series[name if scope == "train" else f"{scope} {name}"][step] = line[name]
    if not series:
        raise ValueError(f"{path} holds no metrics yet")
    return {name: sorted(values.items()) for name, values in series.items()}


def draw(runs: dict[str, Series], path: Path) -> Figure:
    """A panel a number; logarithmic where everything is positive and spans more than a factor of three."""
    names = list(dict.fromkeys(name for series in runs.values() for name in series))
    rows = math.ceil(len(names) / _COLUMNS)
    figure = Figure(figsize=(3.4 * min(_COLUMNS, len(names)), 2.4 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels = np.atleast_1d(figure.subplots(rows, min(_COLUMNS, len(names)))).ravel()
    for panel, name in zip(panels, names, strict=False):
        values = []
        for run, series in runs.items():
            if name in series:
                steps, numbers = zip(*series[name], strict=True)
                panel.plot(steps, numbers, ".-" if len(steps) < 60 else "-", lw=1, label=run)
                values += numbers
        if min(values) > 0 and max(values) > 3 * min(values):
            panel.set_yscale("log")
        panel.set_title(name, fontsize=9)
        panel.tick_params(labelsize=7)
        panel.grid(alpha=0.3, which="both", lw=0.4)
    for panel in panels[len(names) :]:
        panel.set_axis_off()
    panels[0].legend(fontsize=7)
    figure.supxlabel("training step", fontsize=9)
    save_figure(figure, path, dpi=110)
    return figure


if __name__ == "__main__":
    main()
