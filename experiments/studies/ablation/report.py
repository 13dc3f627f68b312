"""Report of an ablation: tables with intervals over seeds, a verdict per row, and the effect of windows on prompts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student

from experiments.studies.ablation.entries import ENTRIES
from experiments.studies.ablation.judge import DIGITS, HEADLINE, METRICS
from experiments.studies.ablation.picture import draw
from experiments.studies.page import rounded, table_lines, write_page

Run = dict[str, Any]
LEVEL = 0.95
_DIGITS = 6  # significant, of numbers in OUT.json


class Spread(NamedTuple):
    """Mean over seeds, and half the width of its interval (Student's t); NaN with fewer than two seeds."""

    mean: float
    half: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """The spread over seeds; seeds without a value are left out."""
        finite = np.array([value for value in values if math.isfinite(value)])
        if len(finite) < 2:
            return cls(float(finite.mean()) if len(finite) else math.nan, math.nan)
        quantile = student.ppf((1 + LEVEL) / 2, len(finite) - 1)
        return cls(float(finite.mean()), float(quantile * finite.std(ddof=1) / math.sqrt(len(finite))))

    def format(self, digits: int = 3) -> str:
        """As text for a table."""
        if not math.isfinite(self.mean):
            return ""
        return f"{self.mean:.{digits}f}" + (f" ± {self.half:.{digits}f}" if math.isfinite(self.half) else "")


def write_report(runs: Sequence[Run], out: Path, setting: Mapping[str, Any], command: str) -> Path:
    """Writes OUT.json, OUT.png and OUT.md of the runs so far; returns the last."""
    content = {"level": LEVEL, "setting": setting, "runs": rounded(list(runs), _DIGITS)}
    write_page(out, markdown(runs, command), content, draw(summary(runs)))
    return out.with_name(f"{out.name}.md")


def summary(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """A row per modality and entry: the verdict, and for each metric the spreads of own, shuffled and both gains."""
    rows = []
    for modality, name in dict.fromkeys((run["modality"], run["entry"]) for run in runs):
        mine = _of(runs, modality, name)
        spreads = {
            metric: {
                "own": Spread.of([run["own"][metric] for run in mine]),
                "shuffled": Spread.of([run["shuffled"][metric] for run in mine]),
                "over_shuffled": over_shuffled(runs, modality, name, metric),
                "over_none": over_none(runs, modality, name, metric),
            }
            for metric in METRICS
        }
        cost = ("parameters", "flops", "flops_cached", "seconds_per_step", "seconds_per_scene")
        rows.append(
            {
                "modality": modality,
                "entry": name,
                "title": ENTRIES[name].title,
                "seeds": [run["seed"] for run in mine],
                "verdict": verdict(runs, modality, name),
                "metrics": spreads,
                **{field: float(np.median([run[field] for run in mine])) for field in cost},
            }
        )
    return rows


def over_shuffled(runs: Sequence[Run], modality: str, name: str, metric: str) -> Spread:
    """Gain of a metric with own over shuffled conditions, per seed; above 0 is better."""
    sign = 1 if METRICS[metric].more_is_better else -1
    return Spread.of([sign * (run["own"][metric] - run["shuffled"][metric]) for run in _of(runs, modality, name)])


def over_none(runs: Sequence[Run], modality: str, name: str, metric: str) -> Spread:
    """Gain of a metric over the entry without a condition, per seed; above 0 is better."""
    sign = 1 if METRICS[metric].more_is_better else -1
    none = {run["seed"]: run["own"][metric] for run in _of(runs, modality, "none")}
    mine = [run for run in _of(runs, modality, name) if run["seed"] in none]
    return Spread.of([sign * (run["own"][metric] - none[run["seed"]]) for run in mine])


def verdict(runs: Sequence[Run], modality: str, name: str) -> str:
    """Whether the headline metric exceeds no condition and shuffled conditions by more than the interval over seeds.

    If samples gain nothing, a lower loss still shows that the model reads the condition.
    """
    if name == "none":
        return "reference"
    gains, losses = (_gains(runs, modality, name, metric) for metric in (HEADLINE[modality], "loss"))
    unknown = [what for what, gain in gains.items() if not math.isfinite(gain.half)]
    if unknown:
        return f"not judged: too few seeds against {' and '.join(unknown)}"
    missed = [what for what, gain in gains.items() if not gain.mean > gain.half]
    if not missed:
        return "follows its condition"
    read = ", though its loss is lower" if all(gain.mean > gain.half for gain in losses.values()) else ""
    return f"no significant gain over {' or '.join(missed)}{read}"


def _gains(runs: Sequence[Run], modality: str, name: str, metric: str) -> dict[str, Spread]:
    return {"shuffled": over_shuffled(runs, modality, name, metric), "none": over_none(runs, modality, name, metric)}


def markdown(runs: Sequence[Run], command: str) -> str:
    """The page: per modality a table of quality and one of cost; then the effect of windows."""
    rows, parts = summary(runs), [f"# Conditioning mechanisms\n\n`{command}`\n"]
    for modality in dict.fromkeys(row["modality"] for row in rows):
        parts.append(_modality_part(modality, [row for row in rows if row["modality"] == modality]))
    if windows := window_hypothesis(runs):
        parts.append(f"## Windows on prompts\n\n{windows}\n")
    return "\n".join(parts)


def _modality_part(modality: str, rows: Sequence[dict[str, Any]]) -> str:
    headline = HEADLINE[modality]
    shown = [name for name in METRICS if any(math.isfinite(row["metrics"][name]["own"].mean) for row in rows)]
    seeds = max(len(row["seeds"]) for row in rows)
    interval = f"Mean ± half of the {100 * LEVEL:.0f} % interval over {seeds} seeds." if seeds > 1 else "Of one seed."
    head = ["mechanism", "verdict", f"{headline} over shuffled", f"{headline} over none"]
    head += ["loss below shuffled", "loss below none"]
    head += [f"{name} {'↑' if METRICS[name].more_is_better else '↓'}" for name in shown]
    quality, cost = [], []
    for row in rows:
        metrics = row["metrics"]
        gains = [
            metrics[name][gain].format(DIGITS.get(name, 3))
            for name in (headline, "loss")
            for gain in ("over_shuffled", "over_none")
        ]
        values = [metrics[name]["own"].format(DIGITS.get(name, 3)) for name in shown]
        quality.append([row["title"], row["verdict"], *gains, *values])
        sampling = row["seconds_per_scene"]
        cost.append(
            [
                row["title"],
                f"{row['parameters']:,.0f}",
                f"{row['flops'] / 1e6:.1f}",
                f"{row['flops_cached'] / 1e6:.1f}",
                f"{row['seconds_per_step']:.3f}",
                f"{sampling:.3f}" if math.isfinite(sampling) else "",
            ]
        )
    cost_head = ["mechanism", "added parameters", "MFLOP per scene and step", "the same, condition cached"]
    cost_head += ["s per training step", "s per sampled scene"]
    lines = [f"## On {modality}s", "", f"Headline: {METRICS[headline].title}. {interval}", ""]
    lines += [*table_lines(head, quality), "", *table_lines(cost_head, cost)]
    return "\n".join(lines) + "\n"


def window_hypothesis(runs: Sequence[Run]) -> str:
    """Whether windows aligned with the end of the padding fail on prompts while padding alone does not matter."""
    gains = {}
    for name in ("windowed", "windowed_ends", "windowed_padded", "padded"):
        gain = over_shuffled(runs, "text", name, HEADLINE["text"])
        if not math.isfinite(gain.mean):
            return ""
        gains[name] = gain
    lines = [f"- {ENTRIES[name].title}: {gain.format()} over shuffled" for name, gain in gains.items()]
    if not all(math.isfinite(gain.half) for gain in gains.values()):
        conclusion = "Too few seeds for a conclusion."
    elif gains["windowed_padded"].mean > gains["windowed_padded"].half:
        conclusion = "Not seen here: windows at the end of the padding still read the prompt."
    elif min(gains[name].mean - gains[name].half for name in ("windowed", "padded")) > 0:
        conclusion = (
            "Seen here: windows at the end of the padding do not read the prompt, while windows along the diagonal "
            "do, and so does full attention over the same padding."
        )
    else:
        conclusion = "Inconclusive: windows or padding alone show no significant gain either."
    return "\n".join([*lines, "", conclusion])


def _of(runs: Sequence[Run], modality: str, name: str) -> list[Run]:
    return [run for run in runs if (run["modality"], run["entry"]) == (modality, name)]
