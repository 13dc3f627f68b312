"""Are prompts of people obeyed? An independent program says so: one row per way of sampling, one scene a prompt.

    python -m experiments.studies.obedience PROMPTS.jsonl --judge JUDGE.py --runs runs/obedience \\
        --out docs/results/obedience

PROMPTS.jsonl has lines with "id", "style", "language", "prompt" and "asks", the attributes that a person read in the
prompt. Rows: the labels as requests, so that reading plays no part; the same without outlines; the prompts as the
model reads them; the best of four of these, repaired, as the command line writes them; and the labels with other
numbers of sampling steps. All but the best of four are single raw samples: without energy guidance, choice or repair.
The judge (JUDGE.py --prompts FILE --scenes FOLDER --out FOLDER) shares no code with scjax. RUNS keeps the scenes of
every row; rows that are there are not sampled again. With --records, those of the model's training, the page also says
how far scenes are from the nearest scene whose outline the model has.

Writes OUT.md and OUT.json.
"""

from __future__ import annotations

import csv
import dataclasses
import json
import subprocess
import sys
import warnings
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.page import command_line, script_parser, table_lines, write_page
from experiments.studies.prompts import sample_in_calls
from scjax.data import records
from scjax.metrics.novelty import nearest_tiles
from scjax.nn.startup import start_jax
from scjax.scene.files import write_text
from scjax.scene.io import load_npz, save_npz
from scjax.train.objectives.record_outlines import outline_rows

_RAW = {"energy_guidance": False}
_SHOWN_BY_STEPS = ("kinked_lanes", "loose_ends", "overlaps", "twin_lanes")
_SOUND = ("open_joints", "kinked_lanes", "loose_ends", "overlaps", "against_lane", "ego_off_lane", "twin_lanes")
FAULTS = {
    "open_joints": "connections open by more than 0.5 m",
    "kinked_lanes": "kinked lanes",
    "loose_ends": "loose lane ends",
    "overlaps": "overlapping boxes",
    "against_lane": "vehicles against their lane",
    "ego_off_lane": "ego on no lane",
    "twin_lanes": "twin lanes",
}


@dataclasses.dataclass(frozen=True)
class Row:
    """One way of sampling.

    Attributes:
      labels: whether the labels are the requests, instead of the prompts.
      outlines: whether the network is given what each lane and agent is.
      options: of ``scjax.sample``.
    """

    labels: bool
    outlines: bool
    options: Mapping[str, Any]


ROWS = {
    "labels as requests": Row(True, True, _RAW),
    "labels, without outlines": Row(True, False, _RAW),
    "prompts as read": Row(False, True, _RAW),
    "prompts as read, best of 4, repaired": Row(False, True, {"best_of": 4, "repair": True}),
}
STEP_ROWS = {
    **{f"{steps} steps": Row(True, True, {**_RAW, "num_steps": steps, "guidance": 1.0}) for steps in (2, 4, 8, 16, 25)},
    **{
        f"{steps} steps, guidance 2": Row(True, True, {**_RAW, "num_steps": steps, "guidance": 2.0})
        for steps in (8, 25)
    },
}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.obedience", __doc__)
    parser.add_argument("prompts", type=Path, metavar="PROMPTS.jsonl", help="prompts of people with labels")
    parser.add_argument("--judge", type=Path, required=True, help="the program that judges scenes")
    parser.add_argument("--model", help="model folder (default: the one that ships)")
    parser.add_argument(
        "--every", type=int, default=1, metavar="N", help="take every N-th prompt (default: %(default)s)"
    )
    rows = ROWS | STEP_ROWS
    parser.add_argument("--rows", nargs="+", default=list(rows), choices=rows, metavar="ROW", help="(default: all)")
    parser.add_argument("--records", help="records of the model's training")
    parser.add_argument("--runs", type=Path, default=Path("runs/obedience"), help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    parser.add_argument("--seed", type=int, default=3, help="of all rows (default: %(default)s)")
    args = parser.parse_args(arguments)
    try:
        lines = [json.loads(line) for line in args.prompts.read_text(encoding="utf-8").splitlines()][:: args.every]
        start_jax()
        model, found = scjax.load(args.model), {}
        for name in args.rows:
            folder = _folder(args.runs, name)
            sample_row(rows[name], lines, model, folder, name, args.seed)
            found[name] = judge_row(args.judge, folder)
        shown = [name for name in args.rows if name in ROWS]
        distances = measure_distances(args.records, args.runs, shown) if args.records else {}
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.obedience: {error}")
    text = _page(found, distances, command_line("obedience", arguments))
    write_page(args.out, text, {"rows": found, "distances": distances})


def sample_row(
    row: Row, lines: Sequence[dict[str, Any]], model: scjax.Model, folder: Path, title: str, seed: int
) -> None:
    """Writes FOLDER/<id>/scene.npz for every line, and FOLDER/prompts.jsonl last: nothing is done where that is."""
    if (folder / "prompts.jsonl").is_file():
        return
    model = model if row.outlines else dataclasses.replace(model, outlines=None)
    conditions = [
        scjax.Condition(attributes=line["asks"]) if row.labels else scjax.Condition(prompt=line["prompt"])
        for line in lines
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about prompts of which nothing is understood, or too long ones
        scenes = sample_in_calls(conditions, title, seed, model=model, **row.options)
    for line, scene in zip(lines, scenes, strict=True):
        (folder / line["id"]).mkdir(parents=True, exist_ok=True)
        save_npz(scene, folder / line["id"] / "scene.npz")
    write_text(folder / "prompts.jsonl", "".join(json.dumps(line) + "\n" for line in lines))


def judge_row(judge: Path, folder: Path) -> dict[str, Any]:
    """What the judge finds: prompts and wishes that hold, of how many, by style, language and attribute; faults.

    Raises:
      ValueError: the judge fails.
    """
    out, options = folder / "judged", ["--prompts", folder / "prompts.jsonl", "--scenes", folder]
    command = [sys.executable, judge, *options, "--out", out]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError(f"{judge} fails: {done.stderr.strip()[-500:]}")
    with (out / "checks.csv").open(encoding="utf-8") as file:
        checks = list(csv.DictReader(file))
    faults = [
        scene["faults"] for prompt in json.loads((out / "results.json").read_text()) for scene in prompt["scenes"]
    ]
    prompts: dict[str, list[bool]] = defaultdict(list)
    for check in checks:
        prompts[check["id"]].append(check["held"] == "1")
    origin = {check["id"]: check for check in checks}
    return {
        "prompts": _share([all(held) for held in prompts.values()]),
        "wishes": _share([check["held"] == "1" for check in checks]),
        "styles": _shares([(origin[name]["style"], all(held)) for name, held in prompts.items()]),
        "languages": _shares([(origin[name]["language"], all(held)) for name, held in prompts.items()]),
        "attributes": _shares([(check["key"], check["held"] == "1") for check in checks]),
        "faults": {name: _share([scene.get(name, 0) > 0 for scene in faults]) for name in _SOUND},
    }


def measure_distances(records_folder: str, runs: Path, rows: Sequence[str]) -> dict[str, list[float]]:
    """Row -> quartiles of the distance of lanes to the nearest training scene [m]; held-out records for comparison.

    Raises:
      ValueError: there are no such records.
    """
    stored, held_out = (records.open_records(records_folder, split) for split in ("train", "val"))
    bank = [records.sample_scene(records.read_record(stored, row)) for row in outline_rows(len(stored))]
    scenes = {name: [load_npz(path) for path in sorted(_folder(runs, name).glob("*/scene.npz"))] for name in rows}
    number = max(map(len, scenes.values()))
    places = np.unique(np.linspace(0, len(held_out) - 1, min(number, len(held_out))).astype(int)).tolist()
    scenes["held-out records"] = [records.sample_scene(records.read_record(held_out, row)) for row in places]
    distances = {}
    for name, some in tqdm(scenes.items(), "distances", disable=None):
        nearest = [plain.lane_distance for plain, _ in nearest_tiles(some, bank)]
        distances[name] = np.quantile(nearest, (0.25, 0.5, 0.75)).round(2).tolist()
    return distances


def _folder(runs: Path, name: str) -> Path:
    return runs / name.replace(",", "").replace(" ", "-")


def _share(held: Sequence[bool]) -> tuple[int, int]:
    return sum(held), len(held)


def _shares(pairs: Sequence[tuple[str, bool]]) -> dict[str, tuple[int, int]]:
    groups: dict[str, list[bool]] = defaultdict(list)
    for name, held in pairs:
        groups[name].append(held)
    return {name: _share(groups[name]) for name in sorted(groups)}


def _page(found: Mapping[str, dict[str, Any]], distances: Mapping[str, list[float]], command: str) -> str:
    lines = ["# Obedience: what people type, and what comes", "", f"`{command}`", ""]
    by_steps = {name: row for name, row in found.items() if name in STEP_ROWS}
    found = {name: row for name, row in found.items() if name in ROWS}
    lines += table_lines(
        ["scenes", "obeyed in full", "single wishes"],
        [[name, _percent(row["prompts"]), _percent(row["wishes"])] for name, row in found.items()],
    )
    for title, key in (
        ("Obeyed in full, by style", "styles"),
        ("Obeyed in full, by language", "languages"),
        ("Single wishes, by attribute", "attributes"),
    ):
        names = list(dict.fromkeys(name for row in found.values() for name in row[key]))
        cells = [[name, *(_counts(row[key].get(name, (0, 0))) for row in found.values())] for name in names]
        lines += ["", f"## {title}", "", *table_lines(["", *found], cells)]
    cells = [[text, *(_percent(row["faults"][name]) for row in found.values())] for name, text in FAULTS.items()]
    lines += ["", "## Scenes with faults", "", *table_lines(["", *found], cells), ""]
    if by_steps:
        head = ["labels as requests, raw", "in full", "single wishes", *(FAULTS[name] for name in _SHOWN_BY_STEPS)]
        cells = [
            [name, *(_percent(row[key]) for key in ("prompts", "wishes")), *_fault_cells(row, _SHOWN_BY_STEPS)]
            for name, row in by_steps.items()
        ]
        lines += ["## Number of sampling steps, and guidance", "", *table_lines(head, cells), ""]
    if distances:
        lines += ["## Distance to the nearest training scene", "", "Of lanes, quartiles over scenes [m].", ""]
        cells = [[name, *(f"{value:g}" for value in values)] for name, values in distances.items()]
        lines += [*table_lines(["scenes", "25 %", "50 %", "75 %"], cells), ""]
    return "\n".join(lines)


def _fault_cells(row: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    return [_percent(row["faults"][name]) for name in names]


def _percent(share: Sequence[int]) -> str:
    return f"{100 * share[0] / max(share[1], 1):.1f} % of {share[1]}"


def _counts(share: Sequence[int]) -> str:
    return f"{share[0]} of {share[1]}"


if __name__ == "__main__":
    main()
