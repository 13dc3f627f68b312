"""What a report leaves on disk: report.json and report.md, written anew after every section."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import platform
import subprocess
import time
from pathlib import Path
from typing import Any

import jax

from experiments.evaluation import RANDOM_DRAWS, Row
from scjax.model import Model

NOTES = {
    "reconstruction": "Validation tiles, encoded and decoded from the posterior mean, elements matched by index. The "
    "ego is left out of agent centre, z and heading. n: lane points, agents, or true + predicted links.",
    "realism": "Samples have the numbers of lanes and agents and the domain of validation tiles. Vehicles on a lane: "
    "within 1.5 m of a centreline of their own scene, ego included. Overlaps: exact oriented boxes; all classes, or "
    "vehicles alone. Lane angle and off heading (more than 45 degrees): of vehicles on a lane, to the nearest segment.",
    "distributions": "Against the validation tiles, scaled as in the published tables (metrics.md 1-2): Frechet "
    "distances of the lane graph (connectivity and convenience x10), squared Jensen-Shannon distances of vehicles "
    "(x10, x100), route and joint in metres, colliding vehicles in percent. Order of lanes does not matter, distances "
    "are to segments, boxes are exact. The last column is the floor: two random halves, by location, of as many real "
    "training tiles as a comparison has (mean and 95 % of splits); a value within it says nothing.",
    "distributions_compat": "The same as the reference code counts (Scenario Dreamer): its grouping of key points, "
    "vehicles against lane points, collisions of circles.",
    "control": "Samples were made at the counts of validation tiles and know nothing else of them. CCS: mean cosine of "
    "descriptors with the tile asked for; SPG: less that with tiles of other locations; CSC: correlation of distances "
    "between scenes. Count-matched: one of the 5 training tiles of the nearest counts.",
    "novelty": "Nearest training tile by lanes: symmetric mean Chamfer distance of lane points every 2 m, direction "
    "included (opposite directions are 4 m apart), in the ego frames; aligned: the scene may move by up to 4 m and 15 "
    "degrees onto the tile, since training moves tiles too. M, P: match of the scene's agents with that tile's; "
    "copied: share of scenes where most agents match (F1 over 1/2). The column copies holds training tiles moved as "
    "training moves them, what a model that only memorises would score; scenes as new as held-back tiles score like "
    "those. Lane distance alone does not tell: plain straight roads are near to each other everywhere.",
    "lane_conditioned": "Traffic on the lanes of real validation tiles at their number of agents. M (match rate), P, "
    "PxR: mean over 1, 2, 3 m, ego excluded. Random placement knows the true number of vehicles, places nothing else, "
    f"and is drawn {RANDOM_DRAWS} times a tile; the independent sample has the tile's counts and lanes of its own.",
}


class ReportFiles:
    """The report so far, ``report``, and its two files; knows how long each section took."""

    def __init__(self, folder: Path, about: dict[str, Any]):
        self.report: dict[str, Any] = {"about": about, "seconds": {}, "sections": {}}
        self._folder, self._start = folder, time.perf_counter()

    def lap(self, name: str) -> None:
        """The time since the last call belongs to ``name``."""
        now = time.perf_counter()
        self.report["seconds"][name] = round(self.report["seconds"].get(name, 0) + now - self._start, 1)
        self._start = now

    def section(self, name: str, rows: dict[str, Row]) -> None:
        """Adds or replaces a section and writes both files, each under a temporary name first."""
        self.report["sections"][name] = {
            population: {metric: dataclasses.asdict(number) for metric, number in numbers.items()}
            for population, numbers in rows.items()
        }
        self.lap(name)
        text = json.dumps(_finite(self.report), indent=1, allow_nan=False)
        for file, content in (("report.json", text), ("report.md", markdown(self.report))):
            temporary = self._folder / f".{file}.{os.getpid()}.part"
            temporary.write_text(content)
            temporary.replace(self._folder / file)


def about(arguments: dict[str, Any], model: Model) -> dict[str, Any]:
    """What was evaluated, by which code (None outside a git checkout), on which machine."""
    changed = _git("status", "--porcelain")
    return {
        "arguments": {name: str(value) if isinstance(value, Path) else value for name, value in arguments.items()},
        "model": model.notes,
        "representation": model.representation.name,
        "commit": _git("rev-parse", "HEAD"),
        "files_changed_since": None if changed is None else len(changed.splitlines()),
        "machine": {
            "processor": platform.processor() or platform.machine(),
            "cpus": os.cpu_count(),
            "devices": sorted({device.device_kind for device in jax.devices()}),
            "jax": jax.__version__,
        },
    }


def _git(*command: str) -> str | None:
    root = Path(__file__).resolve().parents[1]
    try:
        done = subprocess.run(["git", *command], cwd=root, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def _finite(value: Any) -> Any:
    """JSON knows no NaN: null."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def markdown(report: dict[str, Any]) -> str:
    """The report as tables: a metric a line, a population a column; value [95 % interval] (n; scenes / clusters)."""
    facts = _finite({**report["about"], "seconds": report["seconds"]})
    lines = ["# Report", "", *(f"* {name}: `{json.dumps(fact)}`" for name, fact in facts.items()), ""]
    for section, populations in report["sections"].items():
        lines += [f"## {section.replace('_', ' ').capitalize()}", "", NOTES[section], ""]
        heads = []
        for population, numbers in populations.items():
            first = next(iter(numbers.values()))
            heads.append(f"{population} ({first['scenes']} scenes, {first['clusters']} clusters)")
        lines += [f"| metric | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
        metrics = dict.fromkeys(metric for numbers in populations.values() for metric in numbers)
        for metric in metrics:
            cells = [_cell(numbers[metric]) if metric in numbers else "" for numbers in populations.values()]
            lines.append(f"| {metric} | {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def _cell(number: dict[str, Any]) -> str:
    if math.isnan(number["value"]):
        return "–"
    text = f"{number['value']:.4g}"
    if not math.isnan(number["low"]):
        text += f" [{number['low']:.4g}, {number['high']:.4g}]"
    return text + (f" (n={number['n']})" if number["n"] is not None else "")
