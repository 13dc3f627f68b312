"""How far does a policy drive while the map grows ahead of it?

    python -m experiments.studies.long_drives --drives 20 --out docs/results/long_drives

Each drive begins with the first scene of the prompt, repaired, from which a road leads the ego out. ``RoutePolicy``
drives the ego, ``RouteFollower`` all others, and the map grows by tiles that show the prompt, or whatever fits. A drive
ends ``--beyond`` the ``--meters``, after ``--seconds`` of the simulated time, or where no road goes on.

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
from experiments.studies.page import (
    add_sampling_options,
    command_line,
    rounded,
    script_parser,
    table_lines,
    write_page,
)
from scjax.data.map_joins import connect_lanes
from scjax.generate.arguments import sampling_key
from scjax.metrics.driving import driving_sums, driving_table
from scjax.nn.startup import start_jax
from scjax.outpainting.exits import choose_exit, find_exits, start_lane
from scjax.scene import Scene, TileStatus, save_map, scene_to_map
from scjax.scene.files import write_text
from scjax.sim.drive_loop import DriveResult
from scjax.sim.growing import GrowingDrive
from scjax.sim.policies import RoutePolicy
from scjax.sim.route_follower import RouteFollower
from scjax.sim.simulate import TIME_STEP

PROMPT = "a two-lane road in a town"
_STANDS = 0.5  # m/s
_MAX_DRAWS = 20  # scenes


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.long_drives", __doc__)
    parser.add_argument("--drives", type=int, default=20, metavar="N", help="(default: %(default)s)")
    parser.add_argument("--meters", type=float, default=500.0, help="(default: %(default)s)")
    parser.add_argument("--beyond", type=float, default=20.0, metavar="M", help="(default: %(default)s)")
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
    write_page(args.out, page(rows, args.meters, command_line("long_drives", arguments)), rounded(_columns(rows)))


def _row(args: Any, seed: int) -> dict[str, Any]:
    """What became of one drive; read from RUNS if it was made before."""
    path = args.runs / f"{seed}.json"
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    begin = time.process_time()
    model = scjax.load(args.model)
    scene, draws = first_scene(seed, args.prompt, model)
    run = GrowingDrive(
        sampling_key(seed),
        scene,
        RoutePolicy(),
        condition=args.tiles or None,
        policy_state=None,
        behavior=RouteFollower(),
        actor=None,
        model=model,
    )
    for _ in run.segments(round(args.seconds / TIME_STEP)):
        if run.progress >= args.meters + args.beyond:
            break
    result = run.result()
    row = measure(result, args.seconds) | {
        "seed": seed,
        "draws": draws,
        "processor": time.process_time() - begin,
    }
    scjax.save_log(result.log, args.runs / f"{seed}.npz")
    assert result.map is not None
    save_map(result.map, args.runs / f"{seed}-map.npz")
    write_text(path, json.dumps(row))
    return row


def first_scene(seed: int, prompt: str, model: scjax.Model) -> tuple[Scene, int]:
    """The first scene of a prompt, repaired, whose ego is on a road that leads out of it, and its number, from 1 on.

    Raises:
      ValueError: none of 20 is one.
    """
    for draw in range(_MAX_DRAWS):
        key = jax.random.fold_in(jax.random.key(seed), draw) if draw else jax.random.key(seed)
        scene = scjax.sample(key, prompt, model=model, repair=True)[0].to_numpy()
        map = connect_lanes(scene_to_map(scene))
        x, y, _, _, cos, sin = (float(value) for value in scene.agents[0, :6])
        yaw = float(np.arctan2(sin, cos))
        try:
            exits = find_exits(map, start_lane(map, x, y, yaw))
        except ValueError:  # the ego is on no lane
            continue
        if choose_exit(exits, np.random.default_rng(seed), yaw=yaw, way="straight") is not None:
            return scene, draw + 1
    raise ValueError(f"no road leads out of {_MAX_DRAWS} scenes of {prompt!r}: give another --prompt")


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
            str(row["draws"]),
            f"{row['complete']} of {row['tiles']}",
            *(str(row[name]) for name in ("collisions", "off_road", "runs_red")),
            f"{row['others']['vehicle_collision']:.1f}",
            f"{row['processor']:.0f}",
        ]
        for row in rows
    ]
    head = [
        "seed", "m", "s", "stands %", "scenes drawn", "complete tiles", "collisions", "steps off the road",
        "red lights", "vehicles that collide %", "core s",
    ]  # fmt: skip
    return "\n".join(
        [
            "# Long drives on a map that grows",
            "",
            f"`{command}`",
            "",
            f"{len(far)} of {len(rows)} drives are {meters:.0f} m long. {len(clean)} of these are without a collision,"
            f" a step off the road and a red light passed. The ego stands {_mean(rows, 'stands'):.0f} % of the time.",
            "",
            *table_lines(head, table),
            "",
            _NOTES,
            "",
        ]
    )


def _columns(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The values of all drives by their names, which makes a file a third as long."""
    return {
        name: _columns([row[name] for row in rows]) if isinstance(value, dict) else [row[name] for row in rows]
        for name, value in rows[0].items()
    }


def _mean(rows: Sequence[dict[str, Any]], name: str) -> float:
    """Mean of a share, weighted by the time of each drive [%]."""
    seconds = sum(row["seconds"] for row in rows)
    return 100 * sum(row[name] * row["seconds"] for row in rows) / max(seconds, 1e-9)


_NOTES = """Collisions, steps and lights are those of the driven ego; the vehicles that collide are all others. The ego
stands below 0.5 m/s. A drive begins with the first scene of its seed from which a road leads the ego out.

The map is not the same from the start to the end. A tile beyond which no road goes on is drawn again. Tiles farther
than 60 m from the ego may be taken back, with who is on them. Of stop lines in a row the first counts. Some agents of
new tiles are left out: vehicles, obstacles and standing people that block a lane, and vehicles that a parked one would
keep from setting off. So are those who come so near to others that braking does not help. Nobody enters at the border,
and who is farther than 160 m from the ego is gone. So is who has stood for 40 s in a junction, or on a lane as the
first of a queue.

Core seconds are of all that a drive takes: sampling the scene, tiles, and traffic, and compiling what no drive before
it had compiled."""


if __name__ == "__main__":
    main()
