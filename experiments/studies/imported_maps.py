"""Do maps that people have grow, and take traffic? One more tile at an open end of each, and agents in a window there.

    python -m experiments.studies.imported_maps FILE [FILE...] --out docs/results/imported_maps

Of every file the open end is taken beyond which the least ground is covered. A tile is added there without a prompt, as
``scjax outpaint --at`` does, and eight vehicles are placed around the new seam, as ``scjax place`` does: together with
those that the tile brought. Maps without an open end get vehicles alone, around their longest lane for cars.

Writes OUT.md and OUT.json, and for each file a picture of the tile and its surroundings in RUNS, to be looked at.
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
from scjax.data.map_crop import near_map
from scjax.data.map_joins import connect_lanes
from scjax.nn.startup import start_jax
from scjax.outpainting.coverage import Coverage
from scjax.outpainting.exits import pose_beyond
from scjax.outpainting.window import WindowPose
from scjax.scene import Map, MapSeam, measure_seam
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.scene.polyline import cumulative_length

_VEHICLES = 8
_SHOWN = 80.0  # m around the new tile in its picture


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.imported_maps", __doc__)
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="maps of any format that scjax reads")
    add_sampling_options(parser, "runs/imported_maps", "of the first file")
    args = parser.parse_args(arguments)
    start_jax()
    try:
        model = scjax.load(args.model)
        rows = [
            {"file": path.name} | grown(scjax.import_map(path), model, args.seed + row, args.runs / f"{path.stem}.png")
            for row, path in enumerate(tqdm(args.files, "files", disable=None))
        ]
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.imported_maps: {error}")
    write_page(args.out, page(rows, command_line("imported_maps", ["FILE...", "--out", str(args.out)])), rows)


def grown(map: Map, model: scjax.Model, seed: int, picture: Path) -> dict[str, Any]:
    """What happens at one open end of a map; without any, vehicles are placed around its longest lane."""
    map = connect_lanes(map)
    pose = open_place(map)
    row: dict[str, Any] = {"lanes": map.num_lanes, "tile": "no open end", "fault": "", "connections": 0, "turn": None}
    larger = map
    if pose is None:
        for_cars = [lane.points for lane in map.lanes if lane.lane_type not in NO_CAR_LANE_TYPES]
        points = max(for_cars, key=lambda points: float(cumulative_length(points)[-1]))
        pose = pose_beyond(points, back=float(cumulative_length(points)[-1]) / 2)
    else:
        larger = scjax.extend_map(seed, map, x=pose.x, y=pose.y, yaw=pose.yaw, model=model)
        tile, joints = larger.tiles[-1], measure_seam(larger, seam_of(larger))
        turn = round(float(np.rad2deg(joints.turns.max())), 1) if len(joints.turns) else None
        row |= {"tile": tile.status.value, "fault": tile.fault, "connections": len(joints.turns), "turn": turn}
    condition = scjax.Condition(attributes={"vehicles": _VEHICLES})
    busy = scjax.place(seed, larger, condition, at=(pose.x, pose.y, pose.yaw), model=model, best_of=4, repair=True)
    picture.parent.mkdir(parents=True, exist_ok=True)
    scjax.viz.plot_map(near_map(busy, pose.x, pose.y, _SHOWN), path=picture)
    return row | {"agents": busy.num_agents - larger.num_agents}


def seam_of(map: Map) -> MapSeam:
    """The connections of the last tile's lanes to others."""
    new = set(map.tiles[-1].lane_ids)
    pairs = [(lane.id, item) for lane in map.lanes for item in lane.successors if (lane.id in new) != (item in new)]
    return MapSeam(tiles=(0, 0), start=(0.0, 0.0), end=(0.0, 0.0), connections=tuple(pairs))


def open_place(map: Map) -> WindowPose | None:
    """The window at the open end beyond which the least ground is covered; of several the first one."""
    coverage = Coverage(map)
    lanes = map.lane_by_id
    poses = [
        pose_beyond(lanes[end.lane_id].points) for end in coverage.open_ends(map) if end.at_border and not end.is_start
    ]
    return min(poses, key=lambda pose: coverage.share_ahead(pose.x, pose.y, pose.yaw), default=None)


def page(rows: Sequence[dict[str, Any]], command: str) -> str:
    """The page of the results."""
    head = ["file", "lanes", "new tile", "fault", "connections at the seam", "largest turn [degrees]", "agents placed"]
    table = table_lines(head, [["" if value is None else str(value) for value in row.values()] for row in rows])
    complete, closed = (sum(row["tile"] == status for row in rows) for status in ("complete", "no open end"))
    return "\n".join(
        [
            "# Maps of others, grown",
            "",
            f"`{command}`",
            "",
            f"{complete} of {len(rows) - closed} tiles are complete; {closed} maps have no open end.",
            "",
            *table,
            "",
        ]
    )


if __name__ == "__main__":
    main()
