"""The page of results: which consumer opens how many files, and what formats could not say."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

_TEXT = """# Exported files in the programs of others

Do other programs open what `scjax export` writes? Each of {files} inputs was exported and opened by each program.
{note}Inputs without motion are not replayed. A file counts under these conditions:

- MetaDrive replays the ego to its destination (`arrive_dest`).
- netconvert gives no warning.
- roadgen reads the map and writes it in seven formats.
- The ASAM checkers complete the rules of the schema, and find no issue by any rule.
- CommonRoad's schema has no fault, its library reads, writes and reads the file with nothing changed, and its
  drivability checker takes all obstacles and the border of the road.

```bash
python -m consumers.make
python -m consumers.check FILES --out docs/results/exports.md
```

netconvert runs with `{options}`. Its thresholds for steep and bent lanes are about
roads as built, not about files. Without these options {plain} of {nets} files give a warning.
Warnings about programs of traffic lights, which netconvert makes up since OpenDRIVE holds none, do not count; {lights}
files have one.

Two kinds of warning may remain. "Intersecting left turns" is about ways through a junction whose shapes, as netconvert
draws them, cross. Two files with grades were looked at. There netconvert makes a junction flat and shortens roads that
lie near each other, which leaves steps at their ends. Why others have them was not looked at.
roadgen compares the heights of all ends that are linked in the file itself.

| program | files | opened without a fault |
| --- | --- | --- |
{table}

{faults}
## What the formats could not say

Number of inputs to which it applies, as `scjax export` says it.

| format | what | inputs |
| --- | --- | --- |
{losses}
"""
_OPTIONS = (
    "--opendrive.import-all-lanes --default.junctions.radius 0 --geometry.max-grade 25 --geometry.min-radius 2 "
    "--junctions.limit-turn-speed.warn.straight 100 --junctions.limit-turn-speed.warn.turn 100"
)


def write_page(
    path: Path,
    note: str,
    rows: list[dict],
    losses: dict[str, Counter[str]],
    refusals: list[dict[str, str]],
    absent: list[str],
    files: int,
) -> None:
    """Writes the page."""
    total = Counter(row["consumer"] for row in rows)
    passed = Counter(row["consumer"] for row in rows if row["ok"])
    table = [f"| {name} | {total[name]} | {passed[name]} |" for name in total]
    table += [f"| {name} | 0 | not installed |" for name in absent]
    nets = [row for row in rows if row["consumer"] == "netconvert"]
    faults = [_fault(row) for row in rows if not row["ok"]]
    faults += [f"- {Path(row['file']).name}, {row['format']}: refused, {row['reason']}" for row in refusals]
    text = _TEXT.format(
        files=files,
        note=f"{note}\n" if note else "",
        options=_OPTIONS,
        plain=sum(bool(row["warnings_by_default"]) for row in nets),
        nets=len(nets),
        lights=sum(bool(row.get("signal_program_notes")) for row in nets),
        table="\n".join(table),
        faults="## Faults\n\n" + "\n".join(faults) + "\n" if faults else "No fault was found.\n",
        losses="\n".join(
            f"| {name} | {words} | {found[words]} |" for name, found in losses.items() for words in sorted(found)
        ),
    )
    path.write_text(text, encoding="utf-8")


def _fault(row: dict) -> str:
    """One line for a file that a program did not open without a fault."""
    known = ("error", "example", "schema", "failed", "steps")
    shown = {name: row[name] for name in known if row.get(name)}
    return f"- {Path(row['file']).name}, {row['consumer']}: {json.dumps(shown)[:300]}"
