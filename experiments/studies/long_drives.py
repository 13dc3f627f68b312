"""How far does a policy drive while the map grows ahead of it?

    python -m experiments.studies.long_drives --drives 20 --out docs/results/long_drives

Each drive begins with one scene of the prompt, repaired. ``RoutePolicy`` drives its ego, ``RouteFollower`` all others,
and the map grows by tiles that show the prompt, or whatever fits. A drive ends after ``--meters``, after ``--seconds``
of the simulated time, or where no road goes on.

Writes OUT.md and OUT.json, and in RUNS the map and the end of each drive. Drives that are in RUNS are not made again.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.page import add_sampling_options, command_line, script_parser, table_lines, write_page
from scjax.metrics.driving import driving_sums, driving_table
from scjax.nn.startup import start_jax
from scjax.scene import TileStatus, save_map
from scjax.scene.files import write_text
from scjax.sim.drive import drive_steps
from scjax.sim.drive_loop import DriveResult
from scjax.sim.policies import RoutePolicy
from scjax.sim.route_follower import RouteFollower

PROMPT = "a two-lane road in a town"
_STANDS = 0.5  # m/s


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.long_drives", __doc__)
    parser.add_argument("--drives", type=int, default=20, metavar="N", help="(default: %(default)s)")
    parser.add_argument("--meters", type=float, default=500.0, help="(default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=240.0, help="at most (default: %(default)s)")
    parser.add_argument(
        "--prompt", default="a two-lane road in a town", help="of the first scene (default: %(default)s)"
    )
    parser.add_argument("--tiles", default="", metavar="PROMPT", help="of the tiles; whatever fits by default")
    add_sampling_options(parser, "runs/long_drives", "of the first drive")
    args = parser.parse_args(arguments)
    start_jax()
    try:
        args.runs.mkdir(parents=True, exist_ok=True)
        rows = [_row(args, args.seed + k) for k in tqdm(range(args.drives), "drives", disable=None)]
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.long_drives: {error}")
    write_page(args.out, page(rows, args.meters, command_line("long_drives", arguments)), rows)


def _row(args: Any, seed: int) -> dict[str, Any]:
    """What became of one drive; read from RUNS if it was made before."""
    path = args.runs / f"{seed}.json"
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    begin, processor = time.perf_counter(), time.process_time()
    model = scjax.load(args.model)
    scene = scjax.sample(jax.random.key(seed), args.prompt, model=model, repair=True)[0].to_numpy()
    steps = drive_steps(
        seed, scene, RoutePolicy(), behavior=RouteFollower(), seconds=args.seconds, grow=args.tiles, model=model
    )
    result = None
    for result in steps:
        if result.progress >= args.meters:
            break
    assert result is not None
    row = measure(result, args.seconds) | {
        "seed": seed,
        "clock": time.perf_counter() - begin,
        "processor": time.process_time() - processor,
    }
    scjax.save_log(result.log, args.runs / f"{seed}.npz")
    assert result.map is not None
    save_map(result.map, args.runs / f"{seed}-map.npz")
    write_text(path, json.dumps(row))
    return row


def measure(result: DriveResult, seconds: float) -> dict[str, Any]:
    """The numbers of one drive.

    Args:
      seconds: that it might have lasted.
    """
    log, terms, map = result.log, result.terms, result.map
    assert map is not None
    ego = log.object_ids.index(result.actor)
    speed = np.hypot(*log.velocities[ego, :, :2].T)
    new = [tile for tile in map.tiles if tile.status != TileStatus.KNOWN]
    traffic = driving_table(driving_sums(log))
    return {
        "meters": result.progress,
        "seconds": float(log.timestamps[-1]),
        "stands": float((speed < _STANDS).mean()),
        "ends_early": bool(log.timestamps[-1] < seconds - 0.15),
        "tiles": len(new),
        "complete": sum(tile.status == TileStatus.COMPLETE for tile in new),
        **{name: int(terms[name].sum()) for name in ("off_road", "runs_red")},
        "collisions": int((np.diff(terms["collides"].astype(int), prepend=0) > 0).sum()),
        "others": {name: traffic[name] for name in ("vehicle_collision", "off_road", "red_light", "stuck")},
    }


def page(rows: Sequence[dict[str, Any]], meters: float, command: str) -> str:
    """The page of the results."""
    far = [row for row in rows if row["meters"] >= meters]
    clean = [row for row in far if not (row["collisions"] or row["off_road"] or row["runs_red"])]
    table = [
        [
            str(row["seed"]),
            f"{row['meters']:.0f}",
            f"{row['seconds']:.0f}",
            f"{100 * row['stands']:.0f}",
            f"{row['complete']} of {row['tiles']}",
            *(str(row[name]) for name in ("collisions", "off_road", "runs_red")),
            f"{row['others']['vehicle_collision']:.1f}",
            f"{row['processor']:.0f}",
        ]
        for row in rows
    ]
    head = [
        "seed", "m", "s", "stands %", "complete tiles", "collisions", "steps off the road", "red lights",
        "vehicles that collide %", "core s",
    ]  # fmt: skip
    return "\n".join(
        [
            "# Long drives on a map that grows",
            "",
            f"`{command}`",
            "",
            f"{len(far)} of {len(rows)} drives are {meters:.0f} m long; {len(clean)} of these are without a collision,"
            " a step off the road and a red light passed.",
            "",
            *table_lines(head, table),
            "",
            _NOTES,
            "",
        ]
    )


_NOTES = """Collisions, steps and lights are those of the driven ego. Core seconds are of all that a drive takes:
sampling the scene, tiles, and traffic, and compiling what no drive before it had compiled."""


if __name__ == "__main__":
    main()
