"""Are many samples of one request as varied as scenes of the world that show it?

    python -m experiments.studies.variety --records runs/base/records --out docs/results/variety

For each of four broad requests: scenes of the training's records that show it, each of another place, and as many raw
single samples. The distance to the nearest other scene of the same set says how much the scenes differ: copies of one
scene have none.

Writes OUT.md and OUT.json.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.page import command_line, script_parser, table_lines, write_page
from experiments.studies.prompts import sample_in_calls
from scjax.data.measurements import MeasuredRecords
from scjax.evaluate.sources import RecordScenes
from scjax.language.attributes.table import ATTRIBUTES, check_attributes
from scjax.metrics.novelty import nearest_tiles
from scjax.nn.startup import start_jax
from scjax.scene import Scene

REQUESTS: dict[str, dict[str, Any]] = {
    "a four-way intersection": {"layout": "four-way"},
    "a T-intersection with pedestrians": {"layout": "T", "pedestrians": (1, None)},
    "a straight road with at least six vehicles": {"layout": "straight", "vehicles": (6, None)},
    "a red light": {"signal": "red"},
}
_QUARTILES = (0.25, 0.5, 0.75)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.variety", __doc__)
    parser.add_argument("--records", required=True, help="of the model's training, with attributes")
    parser.add_argument("--model", help="model folder (default: the one that ships)")
    parser.add_argument("--samples", type=int, default=200, metavar="N", help="scenes a set (default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    parser.add_argument("--seed", type=int, default=7, help="(default: %(default)s)")
    args = parser.parse_args(arguments)
    if args.samples < 2:
        parser.error(f"--samples is {args.samples}: give 2 or more")
    start_jax()
    try:
        model, rows = scjax.load(args.model), {}
        source, measured = RecordScenes(args.records, "train"), MeasuredRecords(args.records, "train")
        for name, request in REQUESTS.items():
            recorded = recorded_scenes(source, measured, request, args.samples, args.seed)
            conditions = [scjax.Condition(attributes=request)] * len(recorded)
            sampled = sample_in_calls(conditions, name, args.seed, model=model, energy_guidance=False)
            rows[name] = {"world": spread(recorded), "samples": spread(sampled)}
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.variety: {error}")
    write_page(args.out, _page(rows, command_line("variety", arguments)), rows)


def recorded_scenes(
    source: RecordScenes, measured: MeasuredRecords, request: Mapping[str, Any], number: int, seed: int
) -> list[Scene]:
    """At most so many scenes that show a request, drawn at random, one a place.

    Args:
      source, measured: scenes and attributes of the same records.

    Raises:
      ValueError: fewer than two places show it.
    """
    normal = check_attributes(request)
    rows, places = [], set()
    for row in tqdm(np.random.default_rng(seed).permutation(len(measured)), "records", disable=None):
        if len(rows) == number:
            break
        values, place = measured[int(row)], source.clusters[int(row)]
        if place not in places and all(ATTRIBUTES[name].holds(value, values[name]) for name, value in normal.items()):
            rows.append(int(row))
            places.add(place)
    if len(rows) < 2:
        raise ValueError(f"{source.folder} has {len(rows)} places that show {dict(request)}: build more records")
    return source.read(rows)


def spread(scenes: Sequence[Scene]) -> dict[str, Any]:
    """How much scenes differ: quartiles of the distance of lanes to the nearest other scene [m], and of numbers."""
    nearest = []
    for k, scene in enumerate(tqdm(scenes, "distances", disable=None)):
        (plain, _), *_ = nearest_tiles([scene], [*scenes[:k], *scenes[k + 1 :]])
        nearest.append(plain.lane_distance)
    lanes, agents = ([int(getattr(scene, name)) for scene in scenes] for name in ("num_lanes", "num_agents"))
    return {
        "scenes": len(scenes),
        "distance": np.quantile(nearest, _QUARTILES).round(2).tolist(),
        "lanes": [round(float(np.mean(lanes)), 1), round(float(np.std(lanes)), 1)],
        "agents": [round(float(np.mean(agents)), 1), round(float(np.std(agents)), 1)],
    }


def _page(rows: Mapping[str, Mapping[str, dict[str, Any]]], command: str) -> str:
    cells = [
        [
            name,
            kind,
            str(one["scenes"]),
            ", ".join(f"{value:g}" for value in one["distance"]),
            *("{:g} ± {:g}".format(*one[key]) for key in ("lanes", "agents")),
        ]
        for name, kinds in rows.items()
        for kind, one in kinds.items()
    ]
    head = ["request", "set", "scenes", "lanes to the nearest other scene, quartiles [m]", "lanes", "agents"]
    lines = ["# Variety: many samples of one request", "", f"`{command}`", "", *table_lines(head, cells), ""]
    lines += [
        "Raw single samples. Scenes of the world are of different places. Numbers: mean ± standard deviation.",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
