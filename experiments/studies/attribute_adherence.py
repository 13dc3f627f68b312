"""Do scenes show the attributes that are requested? One row per source of scenes, one column per kind of attribute.

    python -m experiments.studies.attribute_adherence --model=runs/base/denoiser/model --records=runs/base/records \\
        --out=docs/results/attribute_adherence --scenes=runs/adherence

Requests are drawn from held-out records, which fulfill them. Rows: raw single samples at each guidance scale, whose
numbers of lanes and agents are those of the record; the same at the first scale, where the network is given no outline;
the same without the request; and the record itself. Nothing chooses among samples. They are
judged by scjax.language, which also made the requests. With --scenes the scenes of the first scale are written as
FOLDER/<id>/0.npz, with FOLDER/requests.jsonl, for the judge of the shared prompts, which is independent of scjax. It
knows fewer attributes; the others are left out of that file.

Writes OUT.md and OUT.json.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import scjax
from experiments.studies.page import command_line, script_parser, table_lines, write_page
from experiments.studies.prompts import sample_in_calls
from scjax.data import records
from scjax.data.measurements import MeasuredRecords
from scjax.language.attributes.draw import draw_attributes
from scjax.language.attributes.table import GROUPS, score_attributes
from scjax.nn.startup import start_jax
from scjax.scene import Scene
from scjax.scene.files import write_text
from scjax.scene.io import save_npz

_NOT_JUDGED = ("not_layout", "ego_manoeuvre", "ego_lane", "ego_lane_index", "where", "compare")
_MOST_REQUESTED = 8  # attributes of a request


class Requested(NamedTuple):
    """A held-out record and a request that it fulfills."""

    request: dict[str, Any]
    scene: Scene


def held_out_requests(folder: str, model: scjax.Model, number: int, seed: int) -> list[Requested]:
    """Held-out records in random order, each with a request for one to eight attributes.

    Raises:
      ValueError: the records are not measured.
    """
    measured, stored = MeasuredRecords(folder, "val"), records.open_records(folder, "val")
    rng, found = np.random.default_rng(seed), []
    for row in map(int, rng.permutation(len(measured))[:number]):
        request: dict[str, Any] = {}
        while not 1 <= len(request) <= _MOST_REQUESTED:
            request = draw_attributes(measured[row], rng)
        found.append(Requested(request, model.codec.select(records.sample_scene(records.read_record(stored, row)))))
    return found


def measure_shown(scenes: Sequence[Scene], requested: Sequence[Requested]) -> dict[str, Any]:
    """Attribute -> (scenes that show it as requested, scenes of which it is requested); "all": requests met in full."""
    requests, shown, full = Counter(), Counter(), 0
    for scene, (request, _) in zip(scenes, requested, strict=True):
        misses = score_attributes(scene, request).misses
        requests.update(request.keys())
        shown.update(request.keys() - misses.keys())
        full += not misses
    return {"attributes": {name: (shown[name], requests[name]) for name in requests}, "all": (full, len(requested))}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.attribute_adherence", __doc__)
    parser.add_argument("--model", required=True, help="model folder whose denoiser reads attributes")
    parser.add_argument("--records", required=True, help="measured records (scjax data attributes)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    parser.add_argument("--scenes", type=Path, help="folder for the scenes of the first scale")
    parser.add_argument("--samples", type=int, default=192)
    parser.add_argument("--guidance", type=float, nargs="+", default=[2.0])
    parser.add_argument("--num-steps", type=int, default=25)
    parser.add_argument("--temperature", type=float, default=0.8)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    start_jax()
    model = scjax.load(args.model)
    if not model.denoiser.config.attributes:
        sys.exit(f"error: {args.model} reads no attributes: train it with --config.attributes=True")
    requested = held_out_requests(args.records, model, args.samples, args.seed)
    options = {"num_steps": args.num_steps, "temperature": args.temperature, "energy_guidance": False}
    rows: dict[str, dict[str, Any]] = {}
    for scale in args.guidance:
        title, conditions = f"raw samples, guidance {scale:g}", [_condition(one, one.request) for one in requested]
        scenes = sample_in_calls(conditions, title, args.seed, model=model, guidance=scale, **options)
        rows[title] = measure_shown(scenes, requested)
        if args.scenes and scale == args.guidance[0]:
            _write_for_judge(args.scenes, scenes, requested)
    if model.outlines is not None:
        title, conditions = "raw samples without outlines", [_condition(one, one.request) for one in requested]
        without, scale = dataclasses.replace(model, outlines=None), args.guidance[0]
        scenes = sample_in_calls(conditions, title, args.seed, model=without, guidance=scale, **options)
        rows[title] = measure_shown(scenes, requested)
    title, conditions = "raw samples without the request", [_condition(one, {}) for one in requested]
    scenes = sample_in_calls(conditions, title, args.seed, model=model, guidance=1.0, **options)
    rows[title] = measure_shown(scenes, requested)
    rows["the record itself"] = measure_shown([one.scene for one in requested], requested)
    write_page(args.out, _page(rows, command_line("attribute_adherence", arguments)), rows)


def _condition(requested: Requested, request: dict[str, Any]) -> scjax.Condition:
    scene = requested.scene
    lanes, agents = int(scene.num_lanes), int(scene.num_agents)
    return scjax.Condition(num_lanes=lanes, num_agents=agents, domain=int(scene.domain), attributes=request)


def _write_for_judge(folder: Path, scenes: Sequence[Scene], requested: Sequence[Requested]) -> None:
    lines = []
    for number, (scene, one) in enumerate(zip(scenes, requested, strict=True)):
        name = f"r{number:04d}"
        (folder / name).mkdir(parents=True, exist_ok=True)
        save_npz(scene, folder / name / "0.npz")
        request = {key: value for key, value in one.request.items() if key not in _NOT_JUDGED}
        lines.append(json.dumps({"id": name, "style": "attributes", "prompt": "", "asks": request}) + "\n")
    write_text(folder / "requests.jsonl", "".join(lines))


def _page(rows: dict[str, dict[str, Any]], command: str) -> str:
    groups = {group: {item.name for item in items} for group, items in GROUPS.items()}
    head = ["scenes", "requests met in full", "attributes held", *groups]
    lines = []
    for name, row in rows.items():
        counts = row["attributes"]
        parts = [[counts[key] for key in counts if key in keys] for keys in groups.values()]
        lines.append([name, _share([row["all"]]), _share(list(counts.values())), *map(_share, parts)])
    return "\n".join(["# Attribute adherence", "", f"`{command}`", "", *table_lines(head, lines), ""])


def _share(pairs: Sequence[tuple[int, int]]) -> str:
    total = sum(of for _, of in pairs)
    return f"{sum(hits for hits, _ in pairs) / total:.0%} of {total}" if total else "none"


if __name__ == "__main__":
    main()
