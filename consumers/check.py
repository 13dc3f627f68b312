"""Opens exported files in the programs of others: python -m consumers.check [FILES ...] [--root DIR] [--out PAGE]

FILES are scenes, maps, logs, or folders of them; by default the inputs of the page of results, made by
``consumers.inputs``. Each is exported, and opened by every consumer that is installed (``python -m consumers.make``).
Exit status 0: every consumer that is there opens every file.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

from consumers.environments import python_of
from consumers.inputs import make_inputs
from consumers.page import write_page
from scjax.cli.export import log_of_content
from scjax.data.imports import read_any
from scjax.export import EXPORTS, export_log
from scjax.scene import Log

CHECKS = Path(__file__).parent / "checks"


@dataclasses.dataclass(frozen=True)
class Consumer:
    """A program of others.

    Attributes:
      environment: a name in ``consumers.environments.NAMES``; None is the one of scjax.
      script: in ``consumers/checks``.
      formats: whose files it opens.
      needs_motion: whether it needs logs of two steps or more.
      kinds: names of the folders whose files it opens; all, if there are none.
    """

    environment: str | None
    script: str
    formats: tuple[str, ...]
    needs_motion: bool = False
    kinds: tuple[str, ...] = ()

    def opens(self, log: Log, kind: str) -> bool:
        """Whether a log from a folder named ``kind`` is for this program."""
        return (log.num_steps > 1 or not self.needs_motion) and (not self.kinds or kind in self.kinds)


CONSUMERS = {
    "MetaDrive": Consumer("metadrive", "metadrive_replay.py", ("scenarionet",), needs_motion=True),
    "SUMO, roadgen": Consumer("sumo", "sumo_import.py", ("opendrive",)),
    "ASAM checkers": Consumer("asam", "asam_rules.py", ("openscenario",)),
    "CommonRoad": Consumer("commonroad", "commonroad_scenario.py", ("commonroad",)),
    "Gymnasium": Consumer(None, "gymnasium_env.py", ("npz",), kinds=("generated",)),
}
_SUFFIXES = (".npz", ".json", ".json.gz", ".xodr", ".xml", ".osm", ".pkl")


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m consumers.check", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE")
    parser.add_argument("--root", type=Path, help="folder of the environments")
    parser.add_argument("--work", type=Path, default=Path("runs/exports"), help="folder for exported files")
    parser.add_argument("--out", type=Path, help="page to write, such as docs/results/exports.md")
    args = parser.parse_args()
    files = [item for path in args.files for item in _files_in(path)] or make_inputs(args.work / "inputs")
    exported, losses, refusals = export_all(files, args.work)
    rows = [row for name in CONSUMERS for row in run_consumer(name, exported, args.root)]
    absent = [name for name, one in CONSUMERS.items() if _python(one, args.root) is None]
    for row in rows:
        if not row["ok"]:
            print(json.dumps(row))
    if args.out:
        write_page(args.out, rows, losses, refusals, absent, Counter(file.parent.name for file in files))
    passed = Counter(row["consumer"] for row in rows if row["ok"])
    for name, count in Counter(row["consumer"] for row in rows).items():
        print(f"{name}: {passed[name]} of {count}")
    if absent:
        print(f"not installed: {', '.join(absent)} (python -m consumers.make)")
    sys.exit(sum(not row["ok"] for row in rows) + len(refusals) > 0)


def _files_in(path: Path) -> list[Path]:
    return sorted(item for item in path.rglob("*") if item.name.endswith(_SUFFIXES)) if path.is_dir() else [path]


def export_all(
    files: list[Path], work: Path
) -> tuple[dict[str, list[Path]], dict[str, Counter[str]], list[dict[str, str]]]:
    """Exports all files in all formats that a consumer opens.

    Returns:
      Format -> files (a folder for ScenarioNet), format -> what it could not say -> in how many files, and refusals.
    """
    exported: dict[str, list[Path]] = {}
    losses: dict[str, Counter[str]] = {}
    refusals = []
    formats = {name: one for one in CONSUMERS.values() for name in one.formats}
    shutil.rmtree(work / "scenarionet", ignore_errors=True)  # scenarios of an earlier call would be replayed too
    for number, file in enumerate(files):
        log = log_of_content(read_any(file), str(file), None)
        stem = f"{number:03d}-{file.parent.name}-{file.name.partition('.')[0]}"
        for name, consumer in formats.items():
            if not consumer.opens(log, file.parent.name):
                continue
            suffix = EXPORTS[name].suffix
            path = work / name / f"{stem}{suffix}" if suffix else work / name
            renamed = dataclasses.replace(log, metadata=dataclasses.replace(log.metadata, scene_id=stem))
            try:
                report = export_log(renamed, path, name)
            except ValueError as error:
                refusals.append({"file": str(file), "format": name, "reason": str(error)})
                continue
            exported.setdefault(name, [])
            if path not in exported[name]:
                exported[name].append(path)
            if report.losses:
                losses.setdefault(name, Counter()).update(report.losses.keys())
    return exported, losses, refusals


def run_consumer(name: str, exported: dict[str, list[Path]], root: Path | None = None) -> list[dict]:
    """What a consumer says of every file; nothing if it is not installed."""
    consumer = CONSUMERS[name]
    python = _python(consumer, root)
    paths = [path for format in consumer.formats for path in exported.get(format, [])]
    if consumer.environment == "asam":  # it judges both files of a scenario
        paths = [item for path in paths for item in (path, path.with_suffix(".xodr"))]
    if python is None or not paths:
        return []
    command = [str(python), str(CHECKS / consumer.script), *map(str, paths)]
    process = subprocess.run(command, capture_output=True, text=True)
    rows = [
        {"consumer": name, **json.loads(line.removeprefix("RESULT "))}
        for line in process.stdout.splitlines()
        if line.startswith("RESULT ")
    ]
    if process.returncode:
        rows.append({"consumer": name, "file": "", "ok": False, "error": process.stderr[-500:]})
    return rows


def _python(consumer: Consumer, root: Path | None) -> Path | None:
    return Path(sys.executable) if consumer.environment is None else python_of(consumer.environment, root)


if __name__ == "__main__":
    main()
