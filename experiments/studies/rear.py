"""How often is what lies behind a forward scene complete?

    python -m experiments.studies.rear --records runs/base/records --number 40 --out docs/results/rear

Of held-out records the forward scenes are cut, and ``scjax.complete_rear`` adds what is behind their egos, without a
prompt. The tile is complete if every lane that reaches the ego's place goes on and no new lane ends inside.

Writes OUT.md and OUT.json, and in RUNS a picture of each map.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.page import add_sampling_options, command_line, script_parser, table_lines, write_page
from scjax.data import records
from scjax.nn.startup import start_jax
from scjax.outpainting.rear import lanes_back
from scjax.scene import Crop, Scene, TileStatus, scene_to_map

GROUPS = {True: "a lane leads back beside the ego", False: "no lane leads back, such as on one-way roads"}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.rear", __doc__)
    parser.add_argument("--records", required=True, metavar="DIR", help="records with a held-out part")
    parser.add_argument("--number", type=int, default=40, metavar="N", help="scenes (default: %(default)s)")
    add_sampling_options(parser, "runs/rear", "of the first scene")
    args = parser.parse_args(arguments)
    start_jax()
    try:
        model, stored = scjax.load(args.model), records.open_records(args.records, "val")
        places = np.linspace(0, len(stored) - 1, min(args.number, len(stored))).astype(int).tolist()
        args.runs.mkdir(parents=True, exist_ok=True)
        rows = []
        for row, place in enumerate(tqdm(places, "scenes", disable=None)):
            scene = records.sample_scene(records.read_record(stored, place), Crop.FORWARD)
            picture = args.runs / f"{row}.png"
            rows.append(completed(model.codec.select(scene), args.seed + row, model, picture))
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.rear: {error}")
    write_page(args.out, page(rows, command_line("rear", arguments)), rows)


def completed(scene: Scene, seed: int, model: scjax.Model, picture: Path) -> dict[str, Any]:
    """What becomes of one scene."""
    map = scjax.validate_map(scjax.complete_rear(seed, scene, model=model))
    scjax.viz.plot_map(map, path=picture)
    tile = map.tiles[-1]
    return {"back": bool(lanes_back(scene_to_map(scene))), "status": tile.status.value, "fault": tile.fault}


def page(rows: Sequence[dict[str, Any]], command: str) -> str:
    """The page of the results."""
    table = []
    for back, title in GROUPS.items():
        some = [row for row in rows if row["back"] == back]
        counts = [
            sum(row["status"] == status.value for row in some) for status in TileStatus if status != TileStatus.KNOWN
        ]
        table.append([title, str(len(some)), *(str(count) for count in counts)])
    head = ["forward scenes", "number", *(status.value for status in TileStatus if status != TileStatus.KNOWN)]
    return "\n".join(["# What is behind a forward scene", "", f"`{command}`", "", *table_lines(head, table), ""])


if __name__ == "__main__":
    main()
