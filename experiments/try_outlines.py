"""Samples a few scenes from each outline of a model, and writes what became of them into the model.

    python -m experiments.try_outlines --model=runs/text/model --trials=3

Some outlines are drawn as they are meant, others lose an attribute in most samples, or have loose ends. With the trials
``scjax.sample`` prefers those that show the request (``scjax.generate.outline_trials``). A trial costs 0.07 core
seconds. What is in RUNS is not sampled again, so that the command goes on where it was stopped.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

import scjax
from experiments.package_model import ship
from experiments.studies.page import script_parser
from scjax.generate.model import DEFAULT_MODEL
from scjax.generate.try_outlines import Trial, try_outlines
from scjax.language.attributes.table import check_measurements
from scjax.nn.startup import start_jax

_AT_ONCE = 200  # outlines


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.try_outlines", __doc__)
    parser.add_argument("--model", type=Path, default=DEFAULT_MODEL, help="folder (default: the model that ships)")
    parser.add_argument("--trials", type=int, default=3, metavar="N", help="of each outline (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1000, help="of the first trial (default: %(default)s)")
    parser.add_argument("--runs", type=Path, default=Path("runs/try_outlines"), help="(default: %(default)s)")
    args = parser.parse_args(arguments)
    if args.trials < 1:
        parser.error(f"--trials is {args.trials}: give 1 or more")
    start_jax()
    try:
        model = scjax.load(args.model)
        if model.outlines is None:
            raise ValueError(f"{args.model} has no outlines to try: train a denoiser with agent_kinds=True on requests")
        found = [make_trials(model, number, args.seed, args.runs) for number in range(args.trials)]
        outlines = model.outlines.with_trials(
            [[one.measured for one in trials] for trials in zip(*found, strict=True)],
            [[one.faults for one in trials] for trials in zip(*found, strict=True)],
        )
        write_model(dataclasses.replace(model, outlines=outlines), args.model)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.try_outlines: {error}")


def make_trials(model: scjax.Model, number: int, seed: int, runs: Path) -> list[Trial]:
    """One trial of every outline, in order; new ones are added to a file of RUNS.

    Raises:
      ValueError: the model has no outlines, or the file is of another model.
    """
    runs.mkdir(parents=True, exist_ok=True)
    path = runs / f"{number}.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    trials = {one["row"]: Trial(check_measurements(one["measured"]), one["faults"]) for one in map(json.loads, lines)}
    rows = [row for row in range(len(model.outlines or ())) if row not in trials]
    with path.open("a", encoding="utf-8") as file:
        for start in tqdm(range(0, len(rows), _AT_ONCE), f"trial {number + 1}", disable=None):
            part = rows[start : start + _AT_ONCE]
            for row, trial in zip(part, try_outlines(model, part, number, seed), strict=True):
                trials[row] = trial
                file.write(json.dumps({"row": row, **trial._asdict()}) + "\n")
            file.flush()
    return [trials[row] for row in sorted(trials)]


def write_model(model: scjax.Model, folder: Path) -> None:
    """Writes the model into its folder; the model that ships in files of at most 15 MB."""
    if folder.resolve() == DEFAULT_MODEL.resolve():
        ship(model, folder)
    else:
        scjax.save(model, folder)


if __name__ == "__main__":
    main()
