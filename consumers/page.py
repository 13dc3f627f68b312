"""The page of results: which consumer opens how many files, and what formats could not say."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from statistics import median

from consumers.checks.sumo_import import AS_WRITTEN, THRESHOLDS

_TEXT = """# Exported files in the programs of others

`python -m consumers.make`, then `python -m consumers.check --out docs/results/exports.md`.

Do other programs open what `scjax export` writes? Each input was exported and opened by each program.
{inputs}.
Generated logs are roll-outs of 10 s from scenes for every fifth of our development prompts, worlds are synthetic, and
recordings are of four data sets. Prompts and recordings are not in this repository.

A file counts under these conditions:

- MetaDrive replays the ego to its destination (`arrive_dest`), the place where it leaves the map or the log ends. In
  generated logs that is after {steps} of 0.1 s. Inputs of one step are not replayed.
- netconvert gives no warning.
- roadgen reads the map, compares the heights of linked ends, and writes seven formats.
- The ASAM checkers complete the rules of the schema, and find no issue by any rule.
- CommonRoad's schema has no fault, its library reads, writes and reads the file with nothing changed, and its
  drivability checker takes all obstacles and the border of the road.
- Gymnasium's environment checker has no error and no warning for an environment of the log.

| program | {kinds} |
| --- |{lines}
{table}

netconvert runs with `{options}`.
Two of these take files as they are: lanes of all types, and junctions that end where the file says. Two move thresholds
of warnings. Lanes may bend at their ends with radii from 3 m; the default is 9 m. A file without speed limits gets
50 km/h, which bends in junctions may reduce by up to 10 m/s; the default is 5 m/s. With the first two options alone
{plain} of {nets} files give a warning.
netconvert makes up programs of traffic lights, since OpenDRIVE holds none. Warnings about these do not count; they are
in {lights} of the files. It also warns about two left turns nearer than half a lane
that do not meet by the order of the roads around the junction.

{faults}
## What the formats could not say

Number of inputs to which it applies, as `scjax export` says it.

| format | what | inputs |
| --- | --- | --- |
{losses}
"""


def write_page(
    path: Path,
    rows: list[dict],
    losses: dict[str, Counter[str]],
    refusals: list[dict[str, str]],
    absent: list[str],
    inputs: Counter[str],
) -> None:
    """Writes the page.

    Args:
      inputs: kind -> number of files; names of exported files hold the kind.
    """
    names = list(dict.fromkeys(row["consumer"] for row in rows))
    table = [f"| {name} | " + " | ".join(_cell(rows, name, kind) for kind in inputs) + " |" for name in names]
    table += [f"| {name} | " + " | ".join(["not installed"] * len(inputs)) + " |" for name in absent]
    nets = [row for row in rows if row["consumer"] == "netconvert"]
    faults = [_fault(row) for row in rows if not row["ok"]]
    faults += [f"- {Path(row['file']).name}, {row['format']}: refused, {row['reason']}" for row in refusals]
    text = _TEXT.format(
        steps=_steps([row["steps"] for row in rows if "steps" in row and "-generated-" in row["file"]]),
        inputs="Inputs: " + ", ".join(f"{count} {kind}" for kind, count in inputs.items()),
        kinds=" | ".join(inputs),
        lines=" --- |" * len(inputs),
        options=" ".join((*AS_WRITTEN, *THRESHOLDS)),
        plain=sum(bool(row["warnings_by_default"]) for row in nets),
        nets=len(nets),
        lights=sum(bool(row.get("signal_program_notes")) for row in nets),
        table="\n".join(table),
        faults="## Faults\n\n" + "\n".join([*faults, ""]) if faults else "No fault was found.\n",
        losses="\n".join(
            f"| {name} | {words} | {found[words]} |" for name, found in losses.items() for words in sorted(found)
        ),
    )
    path.write_text(text, encoding="utf-8")


def _steps(replays: list[int]) -> str:
    """How long replays are."""
    if not replays:
        return "no steps"
    return f"{min(replays)} to {max(replays)} steps ({median(replays):g} in the median)"


def _cell(rows: list[dict], name: str, kind: str) -> str:
    """How many files of a kind a program opens, of how many."""
    own = [row["ok"] for row in rows if row["consumer"] == name and f"-{kind}-" in row["file"]]
    return f"{sum(own)} of {len(own)}" if own else ""


def _fault(row: dict) -> str:
    """One line for a file that a program did not open without a fault."""
    known = ("error", "example", "schema", "failed", "steps")
    shown = {name: row[name] for name in known if row.get(name)}
    return f"- {Path(row['file']).name.partition('-')[2]}, {row['consumer']}: {json.dumps(shown)[:300]}"
