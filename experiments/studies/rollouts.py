"""How does simulated traffic drive: every behavior model beside recorded motion, on recordings and generated scenes.

    python -m experiments.studies.rollouts --out docs/results/rollouts

Recordings are those of the shared data (``SCJAX_DATA_DIR``), spread evenly over their files. Scenes are generated for
prompts that are spread evenly over those of ``--prompts``. Each start is simulated for ``--seconds``.
On recordings of at least 8 s, ``--repeats`` roll-outs of 8 s also give the realism of the motion.

Writes OUT.md and OUT.json.
"""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.page import command_line, rounded, script_parser, table_lines, write_page
from scjax.metrics.distributions import Sums
from scjax.metrics.driving import driving_sums, driving_table
from scjax.metrics.realism_of_motion import realism_of_motion, realism_of_motion_table
from scjax.nn.startup import start_jax
from scjax.scene import Log, Scene
from scjax.sim.behaviors import BEHAVIORS

PROMPTS = Path("experiments/prompts/free_form.txt")
REALISM_SECONDS = 8.0
DRIVING = {
    "vehicle_collision": "vehicles collide %",
    "off_road": "off the road %",
    "red_light": "run a red light %",
    "stuck": "stuck %",
    "infeasible": "infeasible steps %",
    "progress": "progress m",
}
REALISM = {
    "metametric": "meta-metric",
    "kinematic_likelihood": "kinematic",
    "interactive_likelihood": "interactive",
    "map_based_likelihood": "map",
    "min_ade": "minADE m",
}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.rollouts", __doc__)
    parser.add_argument(
        "--number", type=int, default=50, metavar="N", help="starts of either kind (default: %(default)s)"
    )
    parser.add_argument("--seconds", type=float, default=15.0, help="of each roll-out (default: %(default)s)")
    parser.add_argument("--repeats", type=int, default=8, help="roll-outs for realism (default: %(default)s)")
    parser.add_argument(
        "--prompts", type=Path, default=PROMPTS, metavar="FILE", help="a prompt a line (default: %(default)s)"
    )
    parser.add_argument("--behaviors", nargs="+", default=list(BEHAVIORS), choices=list(BEHAVIORS), metavar="NAME")
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    args = parser.parse_args(arguments)
    start_jax()
    try:
        recordings = read_recordings(args.number)
        scenes = generate_scenes(args.prompts.read_text(encoding="utf-8").splitlines(), args.number, args.seed)
        rows = {
            "recordings": measure(recordings, args.behaviors, args.seconds, args.seed),
            "generated scenes": measure(scenes, args.behaviors, args.seconds, args.seed),
            "realism": measure_realism(recordings, args.behaviors, args.repeats, args.seed),
        }
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.rollouts: {error}")
    write_page(
        args.out, page(rows, len(recordings), len(scenes), args, command_line("rollouts", arguments)), rounded(rows)
    )


def read_recordings(number: int) -> list[Log]:
    """Recordings that are spread evenly over the files of the shared data.

    Raises:
      ValueError: there are none.
    """
    folder = Path(os.environ.get("SCJAX_DATA_DIR") or Path(os.environ.get("SCJAX_SHARED", "../shared")) / "data")
    files = sorted(path for name in ("womd", "nuscenes_mini", "av2") for path in (folder / name).glob("*.json.gz"))
    if not files:
        raise ValueError(f"{folder} holds no recordings: set SCJAX_DATA_DIR")
    chosen = np.linspace(0, len(files) - 1, min(number, len(files))).astype(int)
    return [scjax.import_log(files[row]) for row in tqdm(chosen, "recordings", disable=None)]


def generate_scenes(prompts: Sequence[str], number: int, seed: int) -> list[Scene]:
    """One scene, repaired, for each of ``number`` prompts that are spread evenly over the list."""
    rows = np.linspace(0, len(prompts) - 1, min(number, len(prompts))).astype(int)
    key = jax.random.key(seed)
    return [
        scjax.sample(jax.random.fold_in(key, int(row)), prompts[row], repair=True)[0].to_numpy()
        for row in tqdm(rows, "scenes", disable=None)
    ]


def measure(
    sources: Sequence[Log | Scene], names: Sequence[str], seconds: float, seed: int
) -> dict[str, dict[str, float]]:
    """How traffic drives by each behavior, and in the recordings themselves; the numbers pool all starts."""
    rows = {}
    if isinstance(sources[0], Log):
        rows["recorded"] = driving_table(_added([driving_sums(log) for log in sources]))
    for name in tqdm(names, "behaviors", disable=None):
        begin = time.perf_counter()
        logs = scjax.simulate(seed, list(sources), seconds=seconds, behavior=name)
        rows[name] = driving_table(_added([driving_sums(log) for log in logs]))
        rows[name]["seconds"] = time.perf_counter() - begin
    return rows


def measure_realism(
    recordings: Sequence[Log], names: Sequence[str], repeats: int, seed: int
) -> dict[str, dict[str, float]]:
    """Likelihood of the recorded motion under roll-outs of 8 s, of recordings at 10 Hz that are long enough."""
    steps = round(REALISM_SECONDS / 0.1) + 1
    logs = [log[:steps] for log in recordings if log.num_steps >= steps and abs(log.dt - 0.1) < 0.01]
    rows = {}
    for name in tqdm(names, "realism", disable=None):
        runs = [
            scjax.simulate(jax.random.key(seed + k), logs, seconds=REALISM_SECONDS, behavior=name)
            for k in range(repeats)
        ]
        sums = [realism_of_motion(log, [_on_steps(run[row], log) for run in runs]) for row, log in enumerate(logs)]
        rows[name] = realism_of_motion_table(_added(sums))
    return rows


def _on_steps(simulated: Log, recorded: Log) -> Log:
    """The roll-out with the timestamps of the recording, which begins at the same step."""
    return dataclasses.replace(simulated, timestamps=recorded.timestamps)


def _added(sums: Sequence[Sums]) -> Sums:
    return {name: np.sum([one[name] for one in sums], axis=0) for name in sums[0]}


def page(rows: Mapping[str, Any], recordings: int, scenes: int, args: Any, command: str) -> str:
    """The page of the results."""
    parts = ["# Traffic that moves", "", f"`{command}`", ""]
    for title, count in (("recordings", recordings), ("generated scenes", scenes)):
        parts += [f"## {count} {title}, {args.seconds:g} s", ""]
        table = [[name, *(_number(row[key]) for key in DRIVING)] for name, row in rows[title].items()]
        parts += [*table_lines(["motion", *DRIVING.values()], table), ""]
    parts += [f"## Realism, {args.repeats} roll-outs of {REALISM_SECONDS:g} s", ""]
    table = [[name, *(_number(row[key], 3) for key in REALISM)] for name, row in rows["realism"].items()]
    return "\n".join([*parts, *table_lines(["behavior", *REALISM.values()], table), "", _NOTES, ""])


def _number(value: float, digits: int = 2) -> str:
    return "–" if np.isnan(value) else f"{value:.{digits}f}"


_NOTES = """Driving: `scjax.metrics.driving`. Pairs of boxes that overlap at the start do not count. A vehicle is stuck
if it stands for more than 10 s without a reason. The recorded rows are over the whole recordings, 9 or 20 s.

Realism: `scjax.metrics.realism_of_motion`, the likelihoods of the Waymo Open Sim Agents Challenge with the weights of
2025, from the first step of each recording: without a history, unlike the challenge."""


if __name__ == "__main__":
    main()
