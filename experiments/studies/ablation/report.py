"""What an ablation says: tables with intervals over seeds, a verdict a row, and what windows do to prompts."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student

from experiments.studies.ablation.entries import ENTRIES
from experiments.studies.ablation.judge import DIGITS, HEADLINE, METRICS
from experiments.studies.ablation.picture import draw
from scjax.scene.files import write_text

Run = dict[str, Any]
LEVEL = 0.95


class Spread(NamedTuple):
    """Mean over seeds, and half the width of its interval (Student's t); NaN with fewer than two seeds."""

    mean: float
    half: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Seeds without a value are left out."""
        held = np.array([value for value in values if math.isfinite(value)])
        if len(held) < 2:
            return cls(float(held.mean()) if len(held) else math.nan, math.nan)
        quantile = student.ppf((1 + LEVEL) / 2, len(held) - 1)
        return cls(float(held.mean()), float(quantile * held.std(ddof=1) / math.sqrt(len(held))))

    def told(self, digits: int = 3) -> str:
        """As it stands in a table."""
        if not math.isfinite(self.mean):
            return ""
        return f"{self.mean:.{digits}f}" + (f" ± {self.half:.{digits}f}" if math.isfinite(self.half) else "")


def write(runs: Sequence[Run], workdir: Path, setting: Mapping[str, Any]) -> Path:
    """ablation.json, .png and .md of what is done so far; returns the last."""
    content = {"level": LEVEL, "setting": setting, "runs": list(runs), "rows": summary(runs)}
    report = workdir / "ablation.md"
    write_text(workdir / "ablation.json", json.dumps(content, indent=1))
    write_text(report, markdown(runs))
    draw(content["rows"], workdir / "ablation.png")
    return report


def summary(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """A row a kind and entry: verdict, and of each metric the spread of own, shuffled, and of both gains by seed."""
    rows = []
    for kind, name in dict.fromkeys((run["kind"], run["entry"]) for run in runs):
        mine = _of(runs, kind, name)
        found = {
            metric: {
                "own": Spread.of([run["own"][metric] for run in mine]),
                "shuffled": Spread.of([run["shuffled"][metric] for run in mine]),
                "over_shuffled": over_shuffled(runs, kind, name, metric),
                "over_none": over_none(runs, kind, name, metric),
            }
            for metric in METRICS
        }
        cost = ("parameters", "flops", "flops_cached", "seconds_a_step", "seconds_a_scene")
        rows.append(
            {
                "kind": kind,
                "entry": name,
                "title": ENTRIES[name].title,
                "seeds": [run["seed"] for run in mine],
                "verdict": verdict(runs, kind, name),
                "metrics": found,
                **{field: float(np.median([run[field] for run in mine])) for field in cost},
            }
        )
    return rows


def over_shuffled(runs: Sequence[Run], kind: str, name: str, metric: str) -> Spread:
    """How much better a metric is with a scene's own condition than with another's, seed by seed."""
    sign = 1 if METRICS[metric][1] else -1
    return Spread.of([sign * (run["own"][metric] - run["shuffled"][metric]) for run in _of(runs, kind, name)])


def over_none(runs: Sequence[Run], kind: str, name: str, metric: str) -> Spread:
    """How much better a metric is than without a condition at the same seed."""
    sign = 1 if METRICS[metric][1] else -1
    none = {run["seed"]: run["own"][metric] for run in _of(runs, kind, "none")}
    mine = [run for run in _of(runs, kind, name) if run["seed"] in none]
    return Spread.of([sign * (run["own"][metric] - none[run["seed"]]) for run in mine])


def verdict(runs: Sequence[Run], kind: str, name: str) -> str:
    """Whether a row's headline metric beats no condition and its shuffled twin by more than the interval over seeds.

    Where samples gain nothing, a lower loss tells that the condition is read, but too little to be followed.
    """
    if name == "none":
        return "reference"
    gains, losses = (_gains(runs, kind, name, metric) for metric in (HEADLINE[kind], "loss"))
    unknown = [what for what, gain in gains.items() if not math.isfinite(gain.half)]
    if unknown:
        return f"not judged: too few seeds against {' and '.join(unknown)}"
    missed = [what for what, gain in gains.items() if not gain.mean > gain.half]
    if not missed:
        return "follows its condition"
    read = ", though its loss is lower" if all(gain.mean > gain.half for gain in losses.values()) else ""
    return f"failed: not above {' or '.join(missed)}{read}"


def _gains(runs: Sequence[Run], kind: str, name: str, metric: str) -> dict[str, Spread]:
    return {"its twin": over_shuffled(runs, kind, name, metric), "none": over_none(runs, kind, name, metric)}


def markdown(runs: Sequence[Run]) -> str:
    """A table of quality and one of cost a kind, and what windows do."""
    rows, parts = summary(runs), ["# Conditioning mechanisms\n"]
    for kind in dict.fromkeys(row["kind"] for row in rows):
        mine, headline = [row for row in rows if row["kind"] == kind], HEADLINE[kind]
        shown = [name for name in METRICS if any(math.isfinite(row["metrics"][name]["own"].mean) for row in mine)]
        seeds = max(len(row["seeds"]) for row in mine)
        told = "Of one seed." if seeds == 1 else f"Mean ± half of the {100 * LEVEL:.0f} % interval over {seeds} seeds."
        lines = [
            f"## On {kind}s\n",
            f"Judged by: {METRICS[headline][0]}. {told}\n",
            f"| mechanism | verdict | {headline} over its twin | {headline} over none | "
            "loss under its twin's | loss under none's | "
            + " | ".join(f"{name} {'↑' if METRICS[name][1] else '↓'}" for name in shown)
            + " |",
            "|---" * (6 + len(shown)) + "|",
        ]
        for row in mine:
            found = row["metrics"]
            gains = (
                found[name][gain].told(DIGITS.get(name, 3))
                for name in (headline, "loss")
                for gain in ("over_shuffled", "over_none")
            )
            cells = [row["title"], row["verdict"], *gains]
            cells += [found[name]["own"].told(DIGITS.get(name, 3)) for name in shown]
            lines.append("| " + " | ".join(cells) + " |")
        lines += [
            "",
            "| mechanism | parameters it adds | MFLOP a scene and step | the same, condition cached | "
            "s a training step | s a sampled scene |",
            "|---" * 6 + "|",
        ]
        for row in mine:
            cells = [
                row["title"],
                f"{row['parameters']:,.0f}",
                f"{row['flops'] / 1e6:.1f}",
                f"{row['flops_cached'] / 1e6:.1f}",
                f"{row['seconds_a_step']:.3f}",
            ]
            cells.append(f"{row['seconds_a_scene']:.3f}" if math.isfinite(row["seconds_a_scene"]) else "")
            lines.append("| " + " | ".join(cells) + " |")
        parts.append("\n".join(lines) + "\n")
    if windows := window_hypothesis(runs):
        parts.append(f"## Windows on prompts\n\n{windows}\n")
    return "\n".join(parts)


def window_hypothesis(runs: Sequence[Run]) -> str:
    """Whether windows that end with the padding collapse on prompts, while the padding alone does not matter."""
    told = {}
    for name in ("windowed", "windowed_ends", "windowed_padded", "padded"):
        gain = over_shuffled(runs, "text", name, HEADLINE["text"])
        if not math.isfinite(gain.mean):
            return ""
        told[name] = gain
    lines = [f"- {ENTRIES[name].title}: {gain.told()} over its twin" for name, gain in told.items()]
    if not all(math.isfinite(gain.half) for gain in told.values()):
        conclusion = "Too few seeds to tell."
    elif told["windowed_padded"].mean > told["windowed_padded"].half:
        conclusion = "Not seen here: windows at the end of the padding still read the prompt."
    elif min(told[name].mean - told[name].half for name in ("windowed", "padded")) > 0:
        conclusion = (
            "Seen here: windows at the end of the padding do not read the prompt, while windows along the diagonal "
            "do, and so does full attention over the same padding."
        )
    else:
        conclusion = "Open: what windows or padding alone do is not told from nothing either."
    return "\n".join([*lines, "", conclusion])


def _of(runs: Sequence[Run], kind: str, name: str) -> list[Run]:
    return [run for run in runs if (run["kind"], run["entry"]) == (kind, name)]
