"""How long until the first picture? python -m benchmarks.startup

Prints CPU seconds (all threads, children included) and wall seconds of new processes: help, import, `scjax generate` of
a shipped prompt and `scjax demo`, each with an empty cache folder and once more. Then the programs behind the first
picture: lines of StableHLO, size of the executable, and CPU seconds to trace and lower, to compile, and to read again.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

PROMPT = "a busy four-way intersection with a red light, five vehicles and two pedestrians"

BEFORE = {
    "scjax --help": 1.9,
    "import, sample": 1.8,
    "generate, empty cache": 59.0,
    "generate, second process": 19.0,
}
"""CPU seconds at commit f19532b on two cores of an AMD EPYC (family 25)."""

_SCJAX = "import sys; from scjax.cli import main; sys.argv[0] = 'scjax'; main()"


class Cost(NamedTuple):
    """Seconds of a process."""

    cpu: float
    wall: float


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.startup", description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="help and import only, to see that it runs")
    parser.add_argument("--programs", action="store_true", help=argparse.SUPPRESS)  # the child that lists programs
    args = parser.parse_args(arguments)
    if args.programs:
        print(json.dumps(_programs()))
        return
    from benchmarks import workload

    rows = [_row("scjax --help", _run([_SCJAX, "--help"], {}))]
    rows.append(_row("import, sample", _run(["import scjax; scjax.sample; scjax.load"], {})))
    if not args.smoke:
        rows += [*_twice("generate", ["generate", PROMPT]), *_twice("demo", ["demo"])]
    print(workload.table(rows))
    if not args.smoke:
        print("\n" + workload.table(_program_rows()))
    print(json.dumps({"rows": rows, "machine": workload.machine()}))


def _twice(name: str, words: list[str]) -> list[dict[str, Any]]:
    """A command with an empty cache folder, and in a second process."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {"SCJAX_CACHE": folder}
        costs = [_run([_SCJAX, *words, "--out", folder], environment) for _ in range(2)]
    return [_row(f"{name}, empty cache", costs[0]), _row(f"{name}, second process", costs[1])]


def _row(name: str, cost: Cost) -> dict[str, Any]:
    before = BEFORE.get(name)
    return {
        "process": name,
        "CPU s": cost.cpu,
        "wall s": cost.wall,
        "before": before,
        "ratio": before and before / cost.cpu,
    }


def _run(words: list[str], environment: dict[str, str]) -> Cost:
    """Cost of ``python -c`` with these words; its output is dropped."""
    before, start = _children_seconds(), time.perf_counter()
    subprocess.run([sys.executable, "-c", *words], check=True, env={**os.environ, **environment}, capture_output=True)
    return Cost(_children_seconds() - before, time.perf_counter() - start)


def _children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _program_rows() -> list[dict[str, Any]]:
    """A row for each program behind a first picture, and their sum."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "benchmarks.startup", "--programs"]
        children = [
            subprocess.run(command, check=True, env={**os.environ, "SCJAX_CACHE": folder}, capture_output=True)
            for _ in range(2)
        ]
    cold, second = (json.loads(child.stdout.splitlines()[-1]) for child in children)
    rows = [{**row, "read s": second[name]["read s"]} for name, row in cold.items()]
    sums = {name: sum(row[name] for row in rows) for name in rows[0] if name != "program"}
    return [*rows, {"program": "all", **sums}]


def _programs() -> dict[str, dict[str, Any]]:
    """Samples one prompt and says what each program cost: to compile it, or to read it if it is in the cache folder."""
    import jax

    import scjax
    from scjax.cli.options import DEFAULT_BEST_OF
    from scjax.nn.startup import cache_folder, start_jax
    from scjax.nn.stored_program import StoredProgram

    start_jax()
    rows: dict[str, dict[str, Any]] = {}
    find, lower, compile_program = StoredProgram._load_or_compile, StoredProgram.lower, StoredProgram._compile

    def timed_find(self: StoredProgram, arguments: tuple, signature: tuple) -> Any:
        start, files = time.process_time(), _sizes(cache_folder())
        executable = find(self, arguments, signature)
        row = rows.setdefault(self.name, {"program": self.name})
        row["read s"] = time.process_time() - start
        row["MB"] = (_sizes(cache_folder()) - files) / 1e6
        return executable

    def timed_lower(self: StoredProgram, *arguments: Any) -> Any:
        start = time.process_time()
        lowered = lower(self, *arguments)
        seconds = time.process_time() - start
        lines = lowered.as_text().count("\n")
        rows[self.name] = {"program": self.name, "StableHLO lines": lines, "trace s": seconds}
        return lowered

    def timed_compile(self: StoredProgram, lowered: Any) -> Any:
        start = time.process_time()
        executable = compile_program(self, lowered)
        rows[self.name]["compile s"] = time.process_time() - start
        return executable

    StoredProgram._load_or_compile, StoredProgram.lower = timed_find, timed_lower
    StoredProgram._compile = timed_compile
    condition = scjax.Condition(prompt=PROMPT)
    scjax.sample(jax.random.key(0), [condition], best_of=DEFAULT_BEST_OF)
    return rows


def _sizes(folder: Path) -> int:
    """Bytes of all executables, which have two names each."""
    files = {status.st_ino: status.st_size for status in (path.stat() for path in folder.rglob("*.program"))}
    return sum(files.values())


if __name__ == "__main__":
    main()
