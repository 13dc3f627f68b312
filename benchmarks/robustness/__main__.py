"""Damaged inputs of every kind, and how each one ends: python -m benchmarks.robustness

  ok         accepted, and the result is sound by a check of its own (``invariants``)
  clean      refused by ValueError or FileNotFoundError, or exit status 1 or 2, naming the file, field or argument
  unnamed    refused by a text that names none of them
  traceback  any other exception, or a process that died
  hang       more than 30 s (60 s where networks are compiled) of processor time
  memory     more than 1 GB of memory for one input, or MemoryError
  wrong      accepted, but the result is not sound, or is not what the input says

Prints a table, and up to three examples of every fault. --out has one line of JSON for each faulty input.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, TextIO

from tqdm import tqdm

from benchmarks.robustness.case import FAULTS, OUTCOMES, SOUND
from benchmarks.robustness.pool import Worker, child

_NAMES = (
    "recorded,own-json,own-npz,logs,records,shards,descriptions,measurements,encoders,prompts,official,checkpoints,configs,"
    "commands,models,requests"
)
_EXAMPLES = 3
_LISTING = 300.0  # s that an area may take to list its inputs


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.robustness", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--areas", default=_NAMES, help=f"some of {_NAMES}")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the inputs of every area")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="JSON lines of the faulty inputs")
    parser.add_argument("--keep", type=Path, help="folder for the files of the faulty inputs")
    parser.add_argument("--code", type=Path, default=Path(__file__).parents[2], help="checkout that is tested")
    parser.add_argument("--work", type=Path, help="folder of fixtures and caches [default: a temporary one]")
    args = parser.parse_args(arguments)
    if unknown := set(args.areas.split(",")) - set(_NAMES.split(",")):
        parser.error(f"no such area: {', '.join(sorted(unknown))}; choose from {_NAMES}")
    if not 0 < args.scale <= 1:
        parser.error(f"--scale is {args.scale}: give a share above 0, up to 1")
    with tempfile.TemporaryDirectory() as temporary:
        work = (args.work or Path(temporary)).resolve()
        fixtures = make_fixtures(args.code.resolve(), work)
        if args.out:
            args.out.parent.mkdir(parents=True, exist_ok=True)
        with args.out.open("w") if args.out else open(os.devnull, "w") as out:
            rows, faults = run(args, work, fixtures, out)
    print(table(rows))
    print(examples(faults))


def make_fixtures(code: Path, work: Path) -> Path:
    """The folder of sound inputs, made in a process of its own; the text encoder of the cache is linked, not copied."""
    fixtures, cache = work / "fixtures", work / "cache"
    cache.mkdir(parents=True, exist_ok=True)
    encoder = Path(os.environ.get("SCJAX_CACHE", Path.home() / ".cache/scjax")) / "all-MiniLM-L6-v2"
    if encoder.is_dir() and not (cache / encoder.name).exists():
        (cache / encoder.name).symlink_to(encoder.resolve())
    print("making fixtures", file=sys.stderr)
    statement = "from pathlib import Path\nfrom benchmarks.robustness.fixtures import build\nbuild(Path(sys.argv[1]))"
    process = child(code, statement, str(fixtures), cache=cache, cwd=code)
    if process.wait():
        sys.exit("benchmarks.robustness: the fixtures could not be made; see above")
    return fixtures


def run(args: argparse.Namespace, work: Path, fixtures: Path, out: TextIO) -> tuple[list[dict[str, Any]], list[dict]]:
    """A row for each area, and all faults."""
    from benchmarks.robustness.areas import AREAS

    rows, faults = [], []
    worker = Worker(args.code.resolve(), fixtures, work, args.seed)
    for area in args.areas.split(","):
        seconds, start = AREAS[area].seconds, time.perf_counter()
        listing = worker.ask({"area": area}, _LISTING)
        if not isinstance(listing, dict) or "inputs" not in listing:
            reason = listing["unavailable"] if isinstance(listing, dict) else listing
            rows.append({"area": area, "inputs": 0, "not run": reason})
            continue
        counts, distrust = collections.Counter(), []
        indices = range(0, listing["inputs"], max(round(1 / args.scale), 1))
        for index in tqdm(indices, area, unit="input"):
            result = _one(worker, area, index, seconds)
            counts[result["outcome"]] += 1
            if result["text"].endswith(SOUND) and result["outcome"] != "ok":
                distrust.append(f"{area}: an undamaged input ends {result['outcome']}, so this row means little")
            if result["outcome"] in FAULTS:
                faults.append({"area": area, "index": index, **result})
                out.write(json.dumps(faults[-1]) + "\n")
                out.flush()
                if args.keep and worker.folder.is_dir():
                    shutil.rmtree(args.keep / area / str(index), ignore_errors=True)
                    shutil.copytree(worker.folder, args.keep / area / str(index), symlinks=True)
        outcomes = {outcome: counts[outcome] for outcome in OUTCOMES}
        rows.append({"area": area, "inputs": len(indices), **outcomes, "s": round(time.perf_counter() - start)})
        rows[-1]["distrust"] = distrust
        tqdm.write(table(rows[-1:]), file=sys.stderr)
    worker.close()
    shutil.rmtree(worker.folder, ignore_errors=True)
    return rows, faults


def _one(worker: Worker, area: str, index: int, seconds: float) -> dict[str, Any]:
    start = time.perf_counter()
    result = worker.ask({"area": area, "index": index}, seconds)
    if isinstance(result, dict):
        return result
    # A new process lists the inputs again; its time is not that of an input.
    text = worker.ask({"area": area, "index": index, "text": True}, _LISTING)
    outcome = result if result in FAULTS else "traceback"
    return {
        "outcome": outcome,
        "text": text["text"] if isinstance(text, dict) else "",
        "error": result,
        "place": "",
        "message": "",
        "seconds": round(time.perf_counter() - start, 1),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """A table of the areas and their sums."""
    columns = ["area", "inputs", *OUTCOMES, "s"]
    done = [row for row in rows if row["inputs"]]
    sums = {"area": "all", **{name: sum(row[name] for row in done) for name in columns[1:]}}
    lines = [f"| {' | '.join(columns)} |", f"|{' --- |' * len(columns)}"]
    for row in [*done, *([sums] if len(done) > 1 else [])]:
        lines.append(f"| {' | '.join(f'{row[name]:,}' if name != 'area' else row[name] for name in columns)} |")
    lines += [line for row in rows for line in row.get("distrust", ())]
    lines += [f"{row['area']}: not run, {row['not run']}" for row in rows if not row["inputs"]]
    return "\n".join(lines)


def examples(faults: list[dict[str, Any]]) -> str:
    """Up to three examples of every fault: outcome, exception and place."""
    kinds: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for fault in faults:
        kinds.setdefault(fault_kind(fault), []).append(fault)
    lines = []
    for (area, *kind), members in sorted(kinds.items(), key=lambda item: (item[0][0], -len(item[1]))):
        lines.append(f"\n{area}: {len(members)} x {' '.join(part for part in kind if part)}")
        for fault in members[:_EXAMPLES]:
            message = " ".join(fault["message"].split())
            lines.append(f"  [{fault['index']}] {fault['text'][:100]}" + (f" -> {message[:160]}" if message else ""))
    return "\n".join(lines)


def fault_kind(fault: dict[str, Any]) -> tuple[str, ...]:
    """What makes two faults the same one; a wrong result has no place, so the first words of its text stand for it."""
    words = "" if fault["place"] else " ".join(fault["message"].split()[:3])
    return fault["area"], fault["outcome"], fault["error"], fault["place"], words


if __name__ == "__main__":
    main()
